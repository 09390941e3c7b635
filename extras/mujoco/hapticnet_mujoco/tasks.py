"""Scripted hands that open a drawer, turn a screw and palpate a pad, on the workbench of this package."""

import math
from bisect import bisect_right
from itertools import accumulate, pairwise
from typing import Final

import numpy as np

from hapticnet.checks import check_integer, check_parameter
from hapticnet.errors import SettingsError
from hapticnet.operator.scripted import TREMOR_SINUSOIDS, TYPICAL_TREMOR_RMS_M, tremor_waves
from hapticnet.samples import PositionSample, Vector

LEVER_M: Final = 0.1  # a tremor of the fingers turns the wrist by as much over this length: an assumption
WIDE_M, REST_M = 0.034, 0.02  # openings of the gripper
SQUEEZE_M: Final = 0.006  # by which the hand closes further than what it holds is wide

Moves = list[tuple[float, tuple[float, ...]]]
"""Durations [s], and the pose and opening reached then."""

HOME: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, REST_M)


def _drawer() -> Moves:
    """Grip the handle, 14 mm thick; open the drawer to its stop, close it again, and leave."""
    closed_m, opened_m, down_m, held_m = 0.09, -0.0125, -0.11, 0.014 - SQUEEZE_M
    return [
        (1.0, (0.0, closed_m, -0.04, 0.0, 0.0, 0.0, WIDE_M)),
        (0.8, (0.0, closed_m, down_m, 0.0, 0.0, 0.0, WIDE_M)),
        (0.6, (0.0, closed_m, down_m, 0.0, 0.0, 0.0, held_m)),
        (0.4, (0.0, closed_m, down_m, 0.0, 0.0, 0.0, held_m)),
        (2.0, (0.0, opened_m, down_m, 0.0, 0.0, 0.0, held_m)),
        (0.5, (0.0, opened_m, down_m, 0.0, 0.0, 0.0, held_m)),
        (2.0, (0.0, closed_m, down_m, 0.0, 0.0, 0.0, held_m)),
        (0.3, (0.0, closed_m, down_m, 0.0, 0.0, 0.0, held_m)),
        (0.5, (0.0, closed_m, down_m, 0.0, 0.0, 0.0, WIDE_M)),
        (0.8, (0.0, closed_m, -0.04, 0.0, 0.0, 0.0, WIDE_M)),
    ]


def _screw() -> Moves:
    """Grip the knob, 20 mm wide, turn it by 1.6 rad, let go, turn back and grip again: three times."""
    at_m, down_m, turn, held_m = (0.15, 0.1), -0.11, 0.8, 0.02 - SQUEEZE_M
    moves: Moves = [
        (1.0, (*at_m, -0.04, 0.0, 0.0, -turn, WIDE_M)),
        (0.8, (*at_m, down_m, 0.0, 0.0, -turn, WIDE_M)),
    ]
    for _ in range(3):
        moves += [
            (0.6, (*at_m, down_m, 0.0, 0.0, -turn, held_m)),
            (0.3, (*at_m, down_m, 0.0, 0.0, -turn, held_m)),
            (1.5, (*at_m, down_m, 0.0, 0.0, turn, held_m)),
            (0.3, (*at_m, down_m, 0.0, 0.0, turn, held_m)),
            (0.5, (*at_m, down_m, 0.0, 0.0, turn, WIDE_M)),
            (1.0, (*at_m, down_m, 0.0, 0.0, -turn, WIDE_M)),
        ]
    return [*moves, (0.8, (*at_m, -0.04, 0.0, 0.0, -turn, WIDE_M))]


def _pad() -> Moves:
    """Press the closed fingers into the pad at four places, 8 to 15 mm deep, and stroke along it once."""
    over_m, touch_m, closed = -0.085, -0.095, (0.0, 0.0, 0.0, 0.006)
    moves: Moves = [(1.2, (-0.15, 0.1, over_m + 0.03, *closed))]
    for x_m, y_m, depth_m in ((0.0, 0.0, 0.012), (0.01, 0.0, 0.008), (-0.01, 0.01, 0.015), (0.0, -0.01, 0.01)):
        moves += [
            (0.5, (-0.15 + x_m, 0.1 + y_m, over_m, *closed)),
            (0.7, (-0.15 + x_m, 0.1 + y_m, touch_m - depth_m, *closed)),
            (0.4, (-0.15 + x_m, 0.1 + y_m, touch_m - depth_m, *closed)),
            (0.6, (-0.15 + x_m, 0.1 + y_m, over_m, *closed)),
        ]
    return [
        *moves,
        (0.6, (-0.165, 0.1, touch_m - 0.008, *closed)),
        (1.5, (-0.135, 0.1, touch_m - 0.008, *closed)),
        (0.6, (-0.135, 0.1, over_m, *closed)),
    ]


TASKS: Final = {"drawer": _drawer, "screw": _screw, "pad": _pad}


class Task:
    """A scripted hand of seven axes on the workbench. Satisfies `hapticnet.operator.base.Operator`.

    It moves with minimum jerk between the poses of a task, like `hapticnet.operator.scripted.ScriptedOperator`, with
    tremor on every axis. The position depends on time and `seed` only.

    Parameters
    ----------
    task
        ``drawer``, ``screw``, ``pad``, or several of them in this order, such as ``drawer+screw``; SettingsError if
        another.
    seed
        Of the tremor.
    tremor_m
        Its root mean square on each axis [m]; the wrist turns by as much over a lever of 0.1 m.
    """

    axes: Final = 7
    parts: Final = ("force:3", "torque:3", "grip:1")

    def __init__(self, task: str = "drawer+screw+pad", seed: int = 0, tremor_m: float = TYPICAL_TREMOR_RMS_M) -> None:
        names = str(task).split("+")
        if not set(names) <= set(TASKS):
            raise SettingsError(f"task is {task!r}; it must be some of {', '.join(TASKS)}, as in drawer+screw")
        check_integer("seed", seed, 0, 2**63)
        check_parameter("tremor_m", tremor_m, 0.0, 0.01, "m")
        moves = [move for name in names for move in (*TASKS[name](), (1.0, HOME))]
        poses = [HOME, *(pose for _, pose in moves)]
        self._ends_us = [round(1e6 * end_s) for end_s in accumulate(duration_s for duration_s, _ in moves)]
        self.duration_us = self._ends_us[-1]
        self._phases = list(zip([0, *self._ends_us], self._ends_us, pairwise(poses), strict=False))
        rng, amplitude = np.random.default_rng(seed), tremor_m * math.sqrt(2.0 / TREMOR_SINUSOIDS)
        sizes = [amplitude] * 3 + [amplitude / LEVER_M] * 3 + [amplitude]
        self._tremor = [(size, tremor_waves(rng) if size else ()) for size in sizes]

    def sample(self, t_us: int) -> PositionSample:
        """Return the pose and the opening at a time [µs]; at the end the hand is back where it began."""
        if not 0 <= t_us < self.duration_us:
            return PositionSample(t_us, HOME)
        start_us, end_us, (before, after) = self._phases[bisect_right(self._ends_us, t_us)]
        tau = (t_us - start_us) / (end_us - start_us)
        share = tau * tau * tau * (10.0 + tau * (6.0 * tau - 15.0))
        position: Vector = tuple([
            x + share * (y - x) + size * sum([math.sin(rad_per_us * t_us + phase) for rad_per_us, phase in waves])
            for x, y, (size, waves) in zip(before, after, self._tremor, strict=True)
        ])  # fmt: skip
        return PositionSample(t_us, position)
