"""The force of a scene along the motion of a hand, without a network: a recording to test codecs on."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.checks import axes_of, check_above
from hapticnet.errors import SettingsError
from hapticnet.experiment.trial import Trial
from hapticnet.operator.base import Operator
from hapticnet.samples import PositionSample
from hapticnet.scene.base import Touchable

LONGEST_US: Final = 600_000_000
"""Longest motion [µs] that is recorded, for a hand that moves without end."""


def scene_trial(scene: Touchable, hand: Operator, *, name: str, rate_hz: float = 1000.0) -> Trial:
    """Return positions and forces as the slave of a perfect channel records them.

    Raises
    ------
    SettingsError
        If hand and scene have different numbers of axes, or the rate is out of range.
    SampleError
        If the scene refuses a position, or its force is not finite.
    """
    duration_us = LONGEST_US if hand.duration_us is None else min(hand.duration_us, LONGEST_US)
    check_above("rate", rate_hz, 1e6 / max(duration_us, 1), 1e6, "Hz")
    # The session starts at 0, and the first position is sent a period later.
    t_us = np.arange(round(1e6 / rate_hz), duration_us, round(1e6 / rate_hz), dtype=np.int64)
    positions = np.array([hand.sample(at_us).position_m for at_us in t_us.tolist()])
    return moved_trial(scene, t_us, positions, name=name)


def placed(positions: FloatArray, start_m: Sequence[float] | None) -> FloatArray:
    """Return positions [m], shape (n, a), moved so that the first is at `start_m`; as they are if that is None.

    Raises
    ------
    SettingsError
        If the start has another number of axes.
    """
    if start_m is None:
        return positions
    if len(start_m) != positions.shape[1]:
        raise SettingsError(
            f"the start has {len(start_m)} coordinates; the positions have {axes_of(positions.shape[1])}"
        )
    moved: FloatArray = positions - positions[0] + np.asarray(start_m, dtype=np.float64)
    return moved


def moved_trial(scene: Touchable, t_us: IntArray, positions: FloatArray, *, name: str) -> Trial:
    """Return the forces of a scene along positions [m], shape (n, a), that a hand passed at `t_us` [µs], shape (n,).

    Raises
    ------
    SettingsError
        If positions and scene have different numbers of axes.
    SampleError
        If the scene refuses a position, or its force is not finite.
    """
    if positions.shape[1] != scene.axes:
        raise SettingsError(f"{name}: the positions have {axes_of(positions.shape[1])}; {scene.name} has {scene.axes}")
    sent = positions.astype(np.float32).astype(np.float64)  # as on the wire
    forces = [
        scene.step(PositionSample(at_us, tuple(at_m))).force_n
        for at_us, at_m in zip(t_us.tolist(), sent.tolist(), strict=True)
    ]
    return Trial(name=name, t_us=t_us, stimuli=np.array(forces).reshape(sent.shape), positions=sent)
