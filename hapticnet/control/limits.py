"""Limits of the target force: clamp and slew limit."""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_above
from hapticnet.hardware import MAX_FORCE_N

SLEW_N_PER_S: Final = 50.0
"""Largest rate of rise [N/s] of the target, and of the held force after the link recovers (``hold.py``). An assumption:
0 to 5 N in 100 ms is two thirds of what the HS-55 can do with a 12 mm arm against a 1 N/mm finger (74 mm/s), so correct
stimuli are not delayed and a wrong one does not strike."""

LONGEST_STEP_US: Final = 20_000
"""Longest time [µs] between two calls that lets a force rise: one servo frame. A process that was paused does not make
up for the pause in one step: the force then rises by at most 1 N at the default slew limit. Calls at less than 50 Hz
make a force rise more slowly than the limit."""

PAUSE_US: Final = 150_000
"""Time [µs] without a call after which the target restarts from 0. The firmware retracts 190 ms after the last
setpoint, so the platform may be anywhere by then, and a target still held would be reached at the servos' speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitSettings:
    """Limits of the target force.

    Attributes
    ----------
    max_force_n
        Largest target force [N].
    slew_n_per_s
        Largest rate of rise [N/s].

    Raises
    ------
    SettingsError
        If a limit is not finite and positive, or exceeds the limit of the device.
    """

    max_force_n: float = MAX_FORCE_N
    slew_n_per_s: float = SLEW_N_PER_S

    def __post_init__(self) -> None:
        check_above("largest force", self.max_force_n, 0, MAX_FORCE_N, "N")
        check_above("slew limit", self.slew_n_per_s, 0, 1e6, "N/s")


class ForceLimiter:
    """Clamp and slew limit for a device that can only press.

    The target lies between 0 and the largest force and never rises faster than the slew limit. It falls without a
    limit: the platform then moves away from the finger, and a delay would only prolong an unwanted force. A force that
    is not finite and positive sets the target to 0, and so does a pause of `PAUSE_US` between two calls.
    """

    __slots__ = ("_force_n", "_max_force_n", "_now_us", "_slew_n_per_us")

    def __init__(self, settings: LimitSettings) -> None:
        self._max_force_n = settings.max_force_n
        self._slew_n_per_us = settings.slew_n_per_s * 1e-6
        self._force_n = 0.0
        self._now_us: int | None = None

    def limit(self, force_n: float, now_us: int) -> float:
        """Return the force [N] nearest to `force_n` that the limits allow; the first call returns 0."""
        before_us = self._now_us
        self._now_us = now_us
        # NaN compares false with everything, so this form rejects it too.
        if not 0.0 < force_n < math.inf:
            self._force_n = 0.0
            return 0.0
        elapsed_us = now_us - before_us if before_us is not None and now_us > before_us else 0
        if elapsed_us >= PAUSE_US:
            self._force_n, elapsed_us = 0.0, 0
        if elapsed_us > LONGEST_STEP_US:
            elapsed_us = LONGEST_STEP_US
        highest_n = self._force_n + self._slew_n_per_us * elapsed_us
        if self._max_force_n < highest_n:
            highest_n = self._max_force_n
        self._force_n = highest_n if highest_n < force_n else force_n
        return self._force_n
