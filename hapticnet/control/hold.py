"""Zero-order hold with an age limit: what the finger feels between two packets, and after the last one."""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.errors import SampleError, SettingsError
from hapticnet.samples import MAX_AXES, Vector

LONGEST_US: Final = 10_000_000
"""Longest age limit or decay [µs]. A stimulus older than ten seconds is not held by anyone's wish."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldSettings:
    """How long a stimulus is held.

    Attributes
    ----------
    age_limit_us
        How long [µs] a stimulus holds after the last sign of life from the link. An assumption: long enough for
        several keepalives to get lost.
    decay_us
        Time [µs] in which a stale stimulus falls to zero. An assumption: short beside the age limit, yet no jerk.

    Raises
    ------
    SettingsError
        If a time is negative or above ten seconds, or the age limit is zero.
    """

    age_limit_us: int = 200_000
    decay_us: int = 100_000

    def __post_init__(self) -> None:
        check_parameter("hold age limit", self.age_limit_us, 1, LONGEST_US, "µs")
        check_parameter("hold decay", self.decay_us, 0, LONGEST_US, "µs")


class Hold:
    """The last stimulus, for as long as the link proves alive.

    In a deadband stream silence means consent: nothing arrives while nothing changes. Only a keepalive tells that from
    a dead link. After the age limit the stimulus falls in a straight line to exactly zero, so the finger is released
    no later than ``age_limit_us + decay_us`` after the last sign of life.

    Age is the sum of the forward steps of the time stamps it is called with, so a clock that jumps backward never
    makes a stimulus younger, and one that jumps forward makes it stale.

    Parameters
    ----------
    settings
        How long a stimulus is held.
    axes
        How many axes a stimulus has.
    """

    __slots__ = ("_age_limit_us", "_age_us", "_axes", "_decay_us", "_force_n", "_now_us", "_zero_n")

    def __init__(self, settings: HoldSettings, *, axes: int = 1) -> None:
        if not 1 <= axes <= MAX_AXES:
            raise SettingsError(f"hold has {axes} axes; 1 to {MAX_AXES} are supported")
        self._age_limit_us = settings.age_limit_us
        self._decay_us = settings.decay_us
        self._axes = axes
        self._zero_n: Vector = (0.0,) * axes
        self._force_n = self._zero_n
        self._age_us = settings.age_limit_us + settings.decay_us + 1
        self._now_us = 0

    def receive(self, force_n: Vector, now_us: int) -> None:
        """Take a new stimulus [N], already decoded.

        Raises
        ------
        SampleError
            If it is not finite or does not have this hold's number of axes; the decoder refuses such a stimulus
            before it comes here.
        """
        # A passive codec may go a threshold beyond the range of stimuli; it is the limits that come after that count.
        if not all(map(math.isfinite, force_n)):
            raise SampleError(f"held force is {force_n}; it must be finite")
        if len(force_n) != self._axes:
            raise SampleError(f"held force has {len(force_n)} axes; this hold has {self._axes}")
        self._force_n = force_n
        self._age_us = 0
        self._now_us = now_us

    def follow(self, force_n: Vector) -> None:
        """Let the stimulus become what the decoder makes of it by now; it is no younger for that."""
        self._force_n = force_n

    def confirm(self, now_us: int) -> None:
        """Note that the link is alive and the held stimulus still the newest, as a keepalive says."""
        self._age_us = 0
        self._now_us = now_us

    def value(self, now_us: int) -> Vector:
        """Return the held stimulus [N]: whole until the age limit, then falling to zero."""
        self._grow_older(now_us)
        overdue_us = self._age_us - self._age_limit_us
        if overdue_us <= 0:
            return self._force_n
        left_us = self._decay_us - overdue_us
        if left_us <= 0:
            return self._zero_n
        share = left_us / self._decay_us
        return tuple([component * share for component in self._force_n])

    def _grow_older(self, now_us: int) -> None:
        if now_us > self._now_us:
            self._age_us += now_us - self._now_us
        self._now_us = now_us
