"""A person's hand: positions that arrive irregularly, made into a smooth motion of bounded speed.

A pointer moves in steps, about 60 a second. Sent unchanged, the steps would be felt as a vibration:
at 40 mm/s in a tissue of 500 N/m, 0.3 N each. The needle therefore follows the hand like a critically damped
mass on a spring: x'' = (target − x)/τ² − 2·x'/τ, solved exactly for each tick. It trails a hand that moves at constant
speed by 2τ and never overshoots. With several axes, the needle is any tool, and the speed limit is that of its path.
"""

import enum
import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import axes_of, check_integer, check_parameter
from hapticnet.errors import SampleError, SettingsError
from hapticnet.samples import MAX_AXES, PositionSample, Vector
from hapticnet.vectors import along, distance, minus, moved, times

LONGEST_STEP_US: Final = 20_000
"""Longest time [µs] by which one sample advances the needle; after a pause it continues from its last position."""

AT_REST_M: Final = 10e-6
"""Distance [m] from its rest position within which a needle that is withdrawn counts as at rest."""


class HandState(enum.IntEnum):
    """What the hand is doing."""

    FREE = 0  # not held; the needle is at rest
    LIVE = 1  # the needle follows the person who holds it
    HOLDING = 2  # that person fell silent; the needle stops where it is
    WITHDRAWING = 3  # not held; the needle is returning to its rest position


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveHandSettings:
    """How the needle follows a hand."""

    axes: int = 1
    rest_m: float = 0.0  # position [m] of the needle while nobody holds the hand; 0 on further axes
    deepest_m: float = 0.1
    reach_m: float = 0.05  # how far [m] the hand moves to each side on further axes
    # τ of the follower [µs]; the needle is 2τ late. The default lets 1 % of a 60 Hz staircase through.
    time_constant_us: int = 25_000
    # Largest speed of the needle [m/s]. Faster, the platform of the fingertip device cannot follow the force.
    speed_m_per_s: float = 0.06
    hold_after_us: int = 300_000  # silence [µs] after which the needle stops where it is
    withdraw_after_us: int = 1_000_000  # silence [µs] after which it is withdrawn and the hand is free

    def __post_init__(self) -> None:
        check_integer("number of axes of the hand", self.axes, 1, MAX_AXES)
        check_parameter("reach of the hand", self.reach_m, 0.001, 10.0, "m")
        check_parameter("rest position of the hand", self.rest_m, -10.0, 10.0, "m")
        check_parameter("deepest position of the hand", self.deepest_m, self.rest_m, 10.0, "m")
        check_parameter("time constant of the hand", self.time_constant_us, 1_000, 1_000_000, "µs")
        check_parameter("speed of the hand", self.speed_m_per_s, 0.001, 1.0, "m/s")
        check_parameter("silence before the hand holds", self.hold_after_us, 10_000, 10_000_000, "µs")
        check_parameter(
            "silence before the hand is withdrawn", self.withdraw_after_us, self.hold_after_us, 60_000_000, "µs"
        )

    @property
    def delay_us(self) -> int:
        """How long [µs] the needle trails a hand that moves at constant speed."""
        return 2 * self.time_constant_us


class LiveHand:
    """An operator whose positions come from a person.

    `take`, `move` and `release` may be called at any time between two samples; they need no clock, because the next
    sample gives the time.
    """

    __slots__ = (
        "_heard_us", "_moved", "_now_us", "_target_m", "_velocity_m_per_s", "axes", "duration_us",
        "position_m", "range_m", "settings", "state",
    )  # fmt: skip

    def __init__(self, settings: LiveHandSettings | None = None) -> None:
        self.settings = settings = settings or LiveHandSettings()
        self.axes = settings.axes  # the first is the needle's
        self.duration_us = None
        self.state = HandState.FREE
        # Smallest and largest position [m] on the first axis; the smallest is the rest position
        self.range_m = (settings.rest_m, settings.deepest_m)
        self.position_m = self._rest_m  # position of the needle [m] at the newest sample
        self._target_m = self.position_m
        self._velocity_m_per_s = times(self.position_m, 0.0)
        self._now_us = 0
        self._heard_us = 0
        self._moved = False

    def set_range(self, rest_m: float, deepest_m: float) -> None:
        """Set the range of the needle; SettingsError if it is empty. The needle moves there at its usual speed."""
        if not (math.isfinite(rest_m) and math.isfinite(deepest_m) and rest_m < deepest_m):
            raise SettingsError(f"the hand's range is {rest_m} to {deepest_m} m; it must not be empty")
        self.range_m = (rest_m, deepest_m)
        if self.state in (HandState.FREE, HandState.WITHDRAWING):
            self.release()
        else:
            self._target_m = self._limited(self._target_m)

    def restart(self, rest_m: float, deepest_m: float) -> None:
        """Put the needle at rest at once, for a restarted scene, with the range as for `set_range`.

        The time of the next sample may restart.
        """
        self.set_range(rest_m, deepest_m)
        self.state = HandState.FREE
        self.position_m = self._target_m = self._rest_m
        self._velocity_m_per_s = times(self.position_m, 0.0)
        self._now_us = self._heard_us = 0
        self._moved = False

    def take(self) -> None:
        """Begin to follow a person from the needle's position."""
        self._target_m = self._stop_m()
        self.state = HandState.LIVE
        self._moved = True

    def move(self, position_m: Vector) -> None:
        """Set the hand's position [m], limited to the range, if somebody holds it.

        Raise SampleError if a component is NaN, or it has another number of axes.
        """
        if len(position_m) != self.axes:
            raise SampleError(f"the position of the hand has {axes_of(len(position_m))}; it must have {self.axes}")
        if any(map(math.isnan, position_m)):
            raise SampleError("the position of the hand has NaN; each component must be a number")
        if self.state is HandState.LIVE or self.state is HandState.HOLDING:
            self._target_m = self._limited(position_m)
            self.state = HandState.LIVE
            self._moved = True

    def release(self) -> None:
        """Withdraw the needle to its rest position, and free the hand."""
        self._target_m = self._rest_m
        self.state = HandState.WITHDRAWING

    def sample(self, t_us: int) -> PositionSample:
        """Return the position of the needle at `t_us` [µs] from the start."""
        elapsed_us = min(max(t_us - self._now_us, 0), LONGEST_STEP_US)
        self._now_us = t_us
        if self.state is not HandState.FREE:
            if self._moved:
                self._moved = False
                self._heard_us = t_us
            elif self.state is not HandState.WITHDRAWING:
                self._watch(t_us - self._heard_us)
            self._follow(elapsed_us * 1e-6)
        return PositionSample(t_us, self.position_m)

    def _watch(self, silent_us: int) -> None:
        """Hold, and later withdraw, if the person has been silent for long enough."""
        if silent_us > self.settings.withdraw_after_us:
            self.release()
        elif silent_us > self.settings.hold_after_us and self.state is HandState.LIVE:
            self._target_m = self._stop_m()
            self.state = HandState.HOLDING

    @property
    def _rest_m(self) -> Vector:
        return (self.range_m[0], *(0.0,) * (self.axes - 1))

    def _limited(self, position_m: Vector) -> Vector:
        """Return the nearest position [m] in the range."""
        lowest_m, highest_m = self.range_m
        reach_m = self.settings.reach_m
        return (
            min(max(position_m[0], lowest_m), highest_m),
            *[min(max(each, -reach_m), reach_m) for each in position_m[1:]],
        )

    def _stop_m(self) -> Vector:
        """Return the nearest position [m] at which the needle can stop without coming back."""
        return self._limited(along(self.position_m, self.settings.time_constant_us * 1e-6, self._velocity_m_per_s))

    def _follow(self, elapsed_s: float) -> None:
        rate_per_s = 1e6 / self.settings.time_constant_us
        fastest_m_per_s = self.settings.speed_m_per_s
        away_m = minus(self.position_m, self._target_m)
        drive_m_per_s = along(self._velocity_m_per_s, rate_per_s, away_m)
        decay = math.exp(-rate_per_s * elapsed_s)
        step_m = minus(times(along(away_m, elapsed_s, drive_m_per_s), decay), away_m)
        velocity_m_per_s = times(along(self._velocity_m_per_s, -rate_per_s * elapsed_s, drive_m_per_s), decay)
        zero = times(away_m, 0.0)
        self.position_m = moved(self.position_m, step_m, fastest_m_per_s * elapsed_s)
        self._velocity_m_per_s = moved(zero, velocity_m_per_s, fastest_m_per_s)
        if self.state is HandState.WITHDRAWING and distance(self.position_m, self._target_m) < AT_REST_M:
            self.position_m = self._target_m
            self._velocity_m_per_s = zero
            self.state = HandState.FREE
