"""The needle's motion: where its tip is, how fast it moves and how much time has passed for the tissue."""

import math
from typing import Final

from hapticnet.samples import LARGEST_COMPONENT

LARGEST_SPEED_M_PER_S: Final = 10.0
"""Bound on the tip's speed [m/s], which two samples with nearly equal time stamps would make boundless.

An assumption: several times faster than a hand that inserts a needle.
"""

LONGEST_STEP_US: Final = 10**15
"""Bound on the time [µs] one step takes, about 32 years, so that the clock always fits a float."""


class Needle:
    """Position, speed and time of the needle, which layers read when what they declare depends on it.

    Time runs by the differences of the sample time stamps and only forwards: a stamp that repeats or goes
    backwards takes no time, and the next one counts from it, so that a clock that was set back cannot stop
    the scene.

    Attributes
    ----------
    tip_m
        Position of the tip [m] at the newest step.
    velocity_m_per_s
        Its velocity [m/s] since the step before, positive into the tissue; zero where no time has passed.
    now_us
        Time [µs] that has passed since the first sample.
    """

    __slots__ = ("_stamp_us", "now_us", "tip_m", "velocity_m_per_s")

    def __init__(self) -> None:
        self.tip_m = -LARGEST_COMPONENT
        self.velocity_m_per_s = 0.0
        self.now_us = 0
        self._stamp_us: int | None = None

    def advance(self, t_us: int, tip_m: float) -> None:
        """Let time pass until the sample at `t_us`, by when the tip will be at `tip_m`."""
        elapsed_us = 0 if self._stamp_us is None else t_us - self._stamp_us
        self._stamp_us = t_us
        if elapsed_us <= 0:
            self.velocity_m_per_s = 0.0
            return
        if elapsed_us > LONGEST_STEP_US:
            elapsed_us = LONGEST_STEP_US
        self.now_us += elapsed_us
        velocity_m_per_s = 1e6 * (tip_m - self.tip_m) / elapsed_us
        if abs(velocity_m_per_s) > LARGEST_SPEED_M_PER_S:
            velocity_m_per_s = math.copysign(LARGEST_SPEED_M_PER_S, velocity_m_per_s)
        self.velocity_m_per_s = velocity_m_per_s
