"""Signals of felt.py: scenes with hands, and recordings with positions.

Each signal has a kind, over which felt.py averages. The motions and the properties of the tissues are assumptions,
chosen to be typical; each scene has one feature that the paper's lacks.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from rate_distortion_signals import recorded_signals

from hapticnet.experiment.trials import Trial, scene_trial
from hapticnet.operator.scripted import InsertionSettings, PalpatingOperator, PalpationSettings, ScriptedOperator
from hapticnet.samples import PositionSample
from hapticnet.scene.settings import BodySceneSettings, SceneSettings, Tissue
from hapticnet.scene.sources import find_scene, make_scene, paper_scene

HAND: Final = InsertionSettings(insertions=2)
THRUST: Final = InsertionSettings(
    insertions=4, push_steps=1, push_s=0.5625, withdraw_s=0.69, approach_s=0.3, pause_s=0.3, rest_s=0.3, variation=0.0
)
"""A push of 60 mm in 0.56 s: 200 mm/s at its fastest, 1.875 times the mean of a minimum-jerk movement."""

SLOW: Final = InsertionSettings(insertions=1, depth_m=0.0285, push_s=6.0, push_steps=3, pause_s=0.5, withdraw_s=2.0)
"""Presses on the paper's first tissue that do not breach it."""

VISCOUS: Final = SceneSettings(
    name="viscous",
    tissues=tuple(
        Tissue(
            name=f"tissue {number}",
            rest_position_m=0.02 * number,
            stiffness_n_per_m=150.0,
            breach_force_n=breach_force_n,
            viscosity_n_s_per_m=10.0,
            shaft_friction_n=0.3,
        )
        for number, breach_force_n in ((1, 1.5), (2, 2.0), (3, 2.5))
    ),
)
STIFFENING: Final = SceneSettings(
    name="stiffening",
    tissues=tuple(
        Tissue(
            name=f"tissue {number}",
            rest_position_m=0.02 * number,
            stiffness_n_per_m=60.0,
            breach_force_n=breach_force_n,
            stiffening_per_m=200.0,
        )
        for number, breach_force_n in ((1, 2.0), (2, 3.5), (3, 5.0))
    ),
)

# Positions [m] over the time [s] since the last second began, in front of a surface at 20 mm and in it
ABRUPT: Final[dict[str, Callable[[float], float]]] = {
    "stops 1 mm in front of a surface": lambda t: min(0.1 * t, 0.019) if t < 0.8 else 0.0,
    "turns round in front of a surface": lambda t: 0.019 - abs(0.1 * t - 0.019) if t < 0.38 else 0.0,
    "presses and lets go at once": lambda t: 0.01 + 0.05 * t if t < 0.25 else 0.01,
    "holds still": lambda _: 0.023,
    "trembles at 10 Hz": lambda t: 0.023 + 0.0005 * math.sin(20.0 * math.pi * t),
    "leaps": lambda t: 0.023 if t > 0.5 else 0.005,
}
"""Hands whose movement cannot be predicted, on the paper's scene."""

PAPER: Final = "paper's scene"
KINDS: Final = (PAPER, "other scenes", "three axes", "abrupt hands", "recorded")


class AbruptHand:
    """Repeats a movement every second; the tracker is off by 10 µm. Satisfies `Operator`."""

    axes: Final = 1
    duration_us: Final = 4_000_000

    def __init__(self, path: Callable[[float], float]) -> None:
        self._path = path
        self._rng = np.random.default_rng(1)

    def sample(self, t_us: int) -> PositionSample:
        """Return the position at a time [µs]."""
        return PositionSample(t_us, (self._path(1e-6 * (t_us % 1_000_000)) + float(self._rng.normal(0.0, 1e-5)),))


def signals(seeds: Sequence[int], recordings: Sequence[str], seconds: float) -> list[tuple[str, Trial]]:
    """Return each kind and signal; recordings are cut after `seconds`, and omitted without positions."""
    found = [(PAPER, _inserted(paper_scene(seed), HAND, seed, f"paper's scene, hand {seed}")) for seed in seeds]
    seed = seeds[0]
    found += [
        (PAPER, _inserted(paper_scene(seed), THRUST, seed, "paper's scene, thrusts of 200 mm/s")),
        (PAPER, _inserted(paper_scene(seed), SLOW, seed, "paper's scene, slow palpation")),
        (KINDS[1], _inserted(VISCOUS, HAND, seed, "viscous, with friction on the shaft")),
        (KINDS[1], _inserted(STIFFENING, HAND, seed, "stiffening")),
    ]
    phantom = find_scene("phantom")
    found += [
        (KINDS[2], _palpated(phantom, PalpationSettings(palpations=1), seed, "phantom, palpation")),
        (
            KINDS[2],
            _palpated(_without_friction(phantom), PalpationSettings(palpations=1), seed, "the same, no friction"),
        ),
    ]
    found += [
        (KINDS[3], scene_trial(make_scene(paper_scene(seed)), AbruptHand(path), name=name))
        for name, path in ABRUPT.items()
    ]
    recorded = [trial for trial in recorded_signals(recordings) if trial.positions is not None]
    return found + [(KINDS[4], _first(trial, seconds)) for trial in recorded]


def _inserted(settings: SceneSettings, motion: InsertionSettings, seed: int, name: str) -> Trial:
    return scene_trial(make_scene(settings), ScriptedOperator(motion, np.random.default_rng(seed)), name=name)


def _palpated(settings: SceneSettings | BodySceneSettings, motion: PalpationSettings, seed: int, name: str) -> Trial:
    return scene_trial(make_scene(settings), PalpatingOperator(motion, np.random.default_rng(seed)), name=name)


def _without_friction(settings: SceneSettings | BodySceneSettings) -> BodySceneSettings:
    assert isinstance(settings, BodySceneSettings)
    return replace(settings, bodies=tuple(replace(body, friction=0.0, static_friction=0.0) for body in settings.bodies))


def _first(trial: Trial, seconds: float) -> Trial:
    """Return the beginning of a recording, so that all have about the same length."""
    samples = slice(0, int(np.searchsorted(trial.t_us, trial.t_us[0] + round(1e6 * seconds))))
    assert trial.positions is not None
    return replace(trial, t_us=trial.t_us[samples], stimuli=trial.stimuli[samples], positions=trial.positions[samples])
