"""Stages between a decoded force and the controller: hold with an age limit, clamp and slew limit."""

import math
from dataclasses import dataclass, replace
from typing import Final

from hapticnet.checks import axes_of, check_above, check_parameter
from hapticnet.errors import SampleError, SettingsError
from hapticnet.hardware import SLEW_N_PER_S
from hapticnet.parts import KINDS, PartsLaw
from hapticnet.perception import WeberLaw
from hapticnet.samples import MAX_AXES, Vector
from hapticnet.vectors import magnitude, times

LONGEST_STEP_US: Final = 20_000
"""Longest time [µs] between two calls that lets a force rise: one servo frame. A process that was paused does not make
up for the pause in one step: the force then rises by at most 1 N at the default slew limit. Calls at less than 50 Hz
make a force rise more slowly than the limit."""

PAUSE_US: Final = 150_000
"""Time [µs] without a call after which the target restarts from 0. The firmware retracts 190 ms after the last
setpoint, so the platform may be anywhere by then, and a target still held would be reached at the servos' speed."""


FASTEST_N_PER_S: Final = 1e6  # a rise [N/s] that is as good as without a limit


class ForceLimiter:
    """Clamp [N] and slew limit [N/s] for a device that can only press.

    The target lies between 0 and the largest force and never rises faster than the slew limit. It falls without a
    limit: the platform then moves away from the finger, and a delay would only prolong an unwanted force. A force that
    is not finite and positive sets the target to 0, and so does a pause of `PAUSE_US` between two calls.
    """

    __slots__ = ("_force_n", "_max_force_n", "_now_us", "_slew_n_per_us")

    def __init__(self, max_force_n: float, slew_n_per_s: float) -> None:
        self._max_force_n = max_force_n
        self._slew_n_per_us = min(slew_n_per_s, FASTEST_N_PER_S) * 1e-6
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


LONGEST_US: Final = 10_000_000
"""Longest age limit or decay [µs]; no application needs to hold a stimulus longer than ten seconds."""

FRESH_US: Final = 100_000
"""Longest silence of the link [µs] in which the force ahead is still predicted: two keepalives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldSettings:
    """Timings of the hold."""

    # Time [µs] a stimulus is held after the last sign of life from the link. An assumption: long enough to lose several
    # keepalives.
    age_limit_us: int = 200_000
    # Time [µs] in which a stale stimulus decays to zero. An assumption: short compared with the age limit, but not
    # abrupt.
    decay_us: int = 100_000
    # Largest rate [N/s] at which the magnitude of the held force rises when a link begins or recovers; by default the
    # slew limit
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
    by at most `rise_n_per_s`, until it is 1 again. A fully applied stimulus may change at any rate;
    the limits at the device (``hold.py``) follow.

    Age is the sum of the forward differences of the time stamps, so a clock that jumps backward never makes a stimulus
    younger, and one that jumps forward makes it stale.
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
        self._released_us = settings.age_limit_us + settings.decay_us  # age from which nothing is applied
        self._rise_n_per_us = settings.rise_n_per_s * 1e-6
        self._axes = axes
        self._zero_n: Vector = (0.0,) * axes
        self._force_n = self._zero_n
        self._age_us = settings.age_limit_us + settings.decay_us + 1
        self._now_us = 0
        # Whether the whole stimulus may stay at any age, because it is small. It still ages.
        self.kept = False
        self._new = False
        self._whole = False
        self._share = 0.0
        self._applied_n = 0.0  # magnitude of the last force returned, while the share is below 1
        self._elapsed_us = 0  # time since then in which the force may rise

    def receive(self, force_n: Vector, now_us: int) -> None:
        """Hold a new stimulus [N], already decoded; raise SampleError if it is not finite or has other axes."""
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
        """Let the next stimulus rise from the force applied now; call this when a new session begins."""
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
        if now_us != self._now_us or self._age_us > self._age_limit_us:  # otherwise nothing has changed
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
        self._applied_n = magnitude(times(self._force_n, share))
        self._whole = False
        self._elapsed_us = 0

    def _rise(self) -> None:
        """Raise the share as far as the magnitude of the force may grow in the time elapsed."""
        wanted_n = magnitude(self._force_n)
        highest_n = self._applied_n + self._rise_n_per_us * self._elapsed_us
        self._elapsed_us = 0
        self._whole = wanted_n <= highest_n
        self._share = 1.0 if self._whole else highest_n / wanted_n
        self._applied_n = min(wanted_n, highest_n)


class PartsHold:
    """A hold for each part of a stimulus. Replaces a `Hold`; a torque rises as that of a force at `parts.LEVER_M`."""

    def __init__(self, settings: HoldSettings, law: PartsLaw) -> None:
        self._parts = tuple(
            (
                each,
                Hold(
                    replace(settings, rise_n_per_s=settings.rise_n_per_s * KINDS[part.kind].m_per_unit), axes=part.axes
                ),
            )
            for part, each in zip(law.parts, law.slices(), strict=True)
        )

    @property
    def kept(self) -> bool:
        """Whether the whole stimulus may stay at any age, because it is small."""
        return self._parts[0][1].kept

    @kept.setter
    def kept(self, kept: bool) -> None:
        for _, hold in self._parts:
            hold.kept = kept

    def receive(self, force_n: Vector, now_us: int) -> None:
        """Hold a new stimulus. See `Hold.receive`."""
        for each, hold in self._parts:
            hold.receive(force_n[each], now_us)

    def restart(self) -> None:
        """Let the next stimulus rise from the one applied now."""
        for _, hold in self._parts:
            hold.restart()

    def release(self) -> None:
        """Apply nothing from now on."""
        for _, hold in self._parts:
            hold.release()

    def follow(self, force_n: Vector, now_us: int) -> bool:
        """Set the stimulus to the decoder's current reconstruction. See `Hold.follow`."""
        applied = [hold.follow(force_n[each], now_us) for each, hold in self._parts]
        return all(applied)

    def confirm(self, now_us: int) -> None:
        """Reset the age."""
        for _, hold in self._parts:
            hold.confirm(now_us)

    def value(self, now_us: int) -> Vector:
        """Return the stimulus to apply. See `Hold.value`."""
        return tuple([x for _, hold in self._parts for x in hold.value(now_us)])

    def is_fresh(self, now_us: int) -> bool:
        """Return whether the whole stimulus is applied and the link alive."""
        return all(hold.is_fresh(now_us) for _, hold in self._parts)


def hold_for(settings: HoldSettings, law: WeberLaw, axes: int) -> Hold | PartsHold:
    """Return the hold of a stimulus."""
    return PartsHold(settings, law) if isinstance(law, PartsLaw) else Hold(settings, axes=axes)
