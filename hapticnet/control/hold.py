"""Zero-order hold with an age limit: the force between two packets and after the last one."""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.errors import SampleError, SettingsError
from hapticnet.samples import MAX_AXES, Vector

LONGEST_US: Final = 10_000_000
"""Longest age limit or decay [µs]; no application needs to hold a stimulus longer than ten seconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldSettings:
    """Timings of the hold.

    Attributes
    ----------
    age_limit_us
        Time [µs] a stimulus is held after the last sign of life from the link. An assumption: long enough to lose
        several keepalives.
    decay_us
        Time [µs] in which a stale stimulus decays to zero. An assumption: short compared with the age limit, but not
        abrupt.

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
    """The last stimulus, held as long as the link is alive.

    In a deadband stream nothing arrives while nothing changes; only keepalives distinguish this from a dead link. After
    the age limit the stimulus decays linearly to exactly zero, so the finger is released at most
    ``age_limit_us + decay_us`` after the last sign of life.

    Age is the sum of the forward differences of the time stamps, so a clock that jumps backward never makes a stimulus
    younger, and one that jumps forward makes it stale.

    Parameters
    ----------
    settings
        Timings.
    axes
        Number of axes of a stimulus.
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
        """Hold a new stimulus [N], already decoded.

        Raises
        ------
        SampleError
            If it is not finite or has the wrong number of axes. Decoders reject such stimuli first.
        """
        # A passive codec may exceed the range of stimuli by a threshold; the limiter that follows bounds the force.
        if not all(map(math.isfinite, force_n)):
            raise SampleError(f"held force is {force_n}; it must be finite")
        if len(force_n) != self._axes:
            raise SampleError(f"held force has {len(force_n)} axes; this hold has {self._axes}")
        self._force_n = force_n
        self._age_us = 0
        self._now_us = now_us

    def follow(self, force_n: Vector) -> None:
        """Set the stimulus [N] to the decoder's current reconstruction, without resetting its age."""
        self._force_n = force_n

    def confirm(self, now_us: int) -> None:
        """Reset the age: a keepalive shows that the link is alive and the held stimulus still the newest."""
        self._age_us = 0
        self._now_us = now_us

    def value(self, now_us: int) -> Vector:
        """Return the held stimulus [N]: unchanged until the age limit, then decaying to zero."""
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
