"""The scripted hand for a scene: insertions on one axis, palpation on two or three."""

import numpy as np

from hapticnet.operator.palpation import PalpatingOperator, PalpationSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator


def scripted_hand(axes: int, times: int, rng: np.random.Generator) -> ScriptedOperator | PalpatingOperator:
    """Return a hand with the default motion that inserts or palpates so many times."""
    if axes == 1:
        return ScriptedOperator(InsertionSettings(insertions=times), rng)
    return PalpatingOperator(PalpationSettings(axes=axes, palpations=times), rng)
