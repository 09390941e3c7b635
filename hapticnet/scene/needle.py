"""Motion of the needle: position and speed of its tip, and the elapsed time."""

import math
from typing import Final

from hapticnet.samples import LARGEST_COMPONENT

LARGEST_SPEED_M_PER_S: Final = 10.0
"""Limit of the tip's speed [m/s]; two samples with nearly equal time stamps would give an unbounded one.

An assumption: several times the speed of a hand that inserts a needle.
"""

LONGEST_STEP_US: Final = 10**15
"""Limit of the duration [µs] of one step, about 32 years, so that the clock always fits a float."""


class Needle:
    """Position, speed and time of the needle, read by layers whose properties depend on them.

    Time is the sum of the forward differences of the sample time stamps. A stamp that repeats or goes backwards adds
    no time, and the next difference is taken from it, so a clock that is set back does not stop the scene.

    Attributes
    ----------
    tip_m
        Position of the tip [m] at the newest sample.
    velocity_m_per_s
        Velocity [m/s] since the previous sample, positive into the tissue; zero if no time has passed.
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
        """Advance time to the sample at `t_us`, at which the tip is at `tip_m`."""
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
