"""Zero-order hold with an age limit: the force between two packets and after the last one."""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import axes_of, check_above, check_parameter
from hapticnet.control.limits import LONGEST_STEP_US, SLEW_N_PER_S
from hapticnet.errors import SampleError, SettingsError
from hapticnet.samples import MAX_AXES, Vector

LONGEST_US: Final = 10_000_000
"""Longest age limit or decay [µs]; no application needs to hold a stimulus longer than ten seconds."""

FRESH_US: Final = 100_000
"""Longest silence of the link [µs] in which the force ahead is still predicted: two keepalives."""


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
    rise_n_per_s
        Largest rate [N/s] at which the magnitude of the held force rises when a link begins or recovers; by default
        the slew limit.

    Raises
    ------
    SettingsError
        If a time is negative or above ten seconds, the age limit is zero, or the rate is not finite and positive.
    """

    age_limit_us: int = 200_000
    decay_us: int = 100_000
    rise_n_per_s: float = SLEW_N_PER_S

    def __post_init__(self) -> None:
        check_parameter("hold age limit", self.age_limit_us, 1, LONGEST_US, "µs")
        check_parameter("hold decay", self.decay_us, 0, LONGEST_US, "µs")
        check_above("rise of the held force", self.rise_n_per_s, 0, 1e6, "N/s")


class Hold:
    """The last stimulus, held as long as the link is alive.

    In a deadband stream nothing arrives while nothing changes; only keepalives distinguish this from a dead link. After
    the age limit the stimulus decays linearly to exactly zero, so the finger is released at most
    ``age_limit_us + decay_us`` after the last sign of life.

    The force is a share (0 to 1) of the stimulus. The share decays while the link is stale. When the link recovers, at
    the first stimulus, and at the first one after `restart`, the share rises so that the magnitude of the force grows
    by at most `rise_n_per_s`, until it is whole again. A stimulus of which the whole is applied may change at any rate;
    the limits at the device (``limits.py``) follow.

    Age is the sum of the forward differences of the time stamps, so a clock that jumps backward never makes a stimulus
    younger, and one that jumps forward makes it stale.

    Parameters
    ----------
    settings
        Timings.
    axes
        Number of axes of a stimulus.

    Attributes
    ----------
    kept
        Whether the whole stimulus may stay however old it is, because it is small. It still grows older.
    """

    __slots__ = (
        "_age_limit_us", "_age_us", "_applied_n", "_axes", "_decay_us", "_elapsed_us", "_force_n", "_new", "_now_us",
        "_released_us", "_rise_n_per_us", "_share", "_whole", "_zero_n", "kept",
    )  # fmt: skip

    def __init__(self, settings: HoldSettings, *, axes: int = 1) -> None:
        if not 1 <= axes <= MAX_AXES:
            raise SettingsError(f"hold has {axes} axes; 1 to {MAX_AXES} are supported")
        self._age_limit_us = settings.age_limit_us
        self._decay_us = settings.decay_us
        self._released_us = settings.age_limit_us + settings.decay_us  # age at which nothing is applied any more
        self._rise_n_per_us = settings.rise_n_per_s * 1e-6
        self._axes = axes
        self._zero_n: Vector = (0.0,) * axes
        self._force_n = self._zero_n
        self._age_us = settings.age_limit_us + settings.decay_us + 1
        self._now_us = 0
        self.kept = False
        self._new = False
        self._whole = False
        self._share = 0.0
        self._applied_n = 0.0  # magnitude of the force returned last, while it is not whole
        self._elapsed_us = 0  # time since then, of which the force may make use to rise

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
            raise SampleError(f"held force has {axes_of(len(force_n))}; this hold has {self._axes}")
        self._grow_older(now_us)
        if self._new:
            self._new = False
            self._note_share(self._share)
        self._force_n = force_n
        self._age_us = 0

    def restart(self) -> None:
        """Let the next stimulus rise from what is applied now; call this when a new session begins."""
        self._new = True

    def release(self) -> None:
        """Apply nothing from now on; the force rises from zero when `value` is called again."""
        self._note_share(0.0)

    def follow(self, force_n: Vector, now_us: int) -> bool:
        """Set the stimulus [N] to the decoder's current reconstruction, without resetting its age.

        Return whether any of it is applied: the link has not been silent for too long.
        """
        self._force_n = force_n
        self._grow_older(now_us)
        return self.kept or self._age_us < self._released_us

    def confirm(self, now_us: int) -> None:
        """Reset the age: a keepalive shows that the link is alive and the held stimulus still the newest."""
        self._grow_older(now_us)
        self._age_us = 0

    def value(self, now_us: int) -> Vector:
        """Return the force [N]: the stimulus until the age limit, then decaying to zero, then rising to it again."""
        if now_us != self._now_us or self._age_us > self._age_limit_us:  # else nothing has changed
            self._grow_older(now_us)
        if self._whole:
            return self._force_n
        if self.kept or self._age_us <= self._age_limit_us:
            self._rise()
        share = self._share
        return tuple([component * share for component in self._force_n]) if share else self._zero_n

    def is_fresh(self, now_us: int) -> bool:
        """Return whether the whole stimulus is applied and the link has been alive within `FRESH_US`."""
        if now_us != self._now_us or self._age_us > self._age_limit_us:
            self._grow_older(now_us)
        return self._whole and self._age_us <= FRESH_US

    def _grow_older(self, now_us: int) -> None:
        if now_us > self._now_us:
            elapsed_us = now_us - self._now_us
            self._age_us += elapsed_us
            # Calls in between add up, but a pause counts no more than one step.
            elapsed_us += self._elapsed_us
            self._elapsed_us = elapsed_us if elapsed_us < LONGEST_STEP_US else LONGEST_STEP_US
        self._now_us = now_us
        overdue_us = self._age_us - self._age_limit_us
        if overdue_us > 0 and not self.kept:
            left_us = self._decay_us - overdue_us
            self._note_share(min(self._share, left_us / self._decay_us) if left_us > 0 else 0.0)

    def _note_share(self, share: float) -> None:
        """Note that this share of the stimulus is applied now, and that it may rise only from there."""
        self._share = share
        self._applied_n = math.hypot(*[component * share for component in self._force_n])
        self._whole = False
        self._elapsed_us = 0

    def _rise(self) -> None:
        """Raise the share as far as the magnitude of the force may grow in the time elapsed."""
        wanted_n = math.hypot(*self._force_n)
        highest_n = self._applied_n + self._rise_n_per_us * self._elapsed_us
        self._elapsed_us = 0
        self._whole = wanted_n <= highest_n
        self._share = 1.0 if self._whole else highest_n / wanted_n
        self._applied_n = min(wanted_n, highest_n)
