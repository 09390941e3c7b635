"""Where a hand is according to the newest line that its master promised, and when the scene is stepped there."""

from typing import Final

from hapticnet.codec.positions import PromisedLine, pack_bound, rounded_bound
from hapticnet.samples import PositionSample, Vector
from hapticnet.stiffness_bound import LONGEST_SILENCE_US, StiffnessBound

GRACE: Final = 1.5
"""How much longer than `LONGEST_SILENCE_US` a line is followed: one position may come late. After that the slave is
silent, so that the master notices."""

RELAXATION: Final = 100
"""A position that took longer than those before counts as late. The shortest delay is forgotten at a hundredth of the
elapsed time, so that a lasting change of the delay is followed."""

VELOCITY_STEP_US: Final = 1
"""Time [µs] between the two steps that give a scene the velocity of a line."""


class DeadReckoning:
    """The slave's view of one hand."""

    def __init__(self, period_us: int) -> None:
        self.line: PromisedLine | None = None  # the newest line
        # the box in which the line is followed, as the master knows it or will be told; None: it is not followed
        self.bound: StiffnessBound | None = None
        self.every = 1  # the scene is stepped along the line each so many periods
        self._period_us = period_us
        self._answered_us = 0  # newest time on the master's clock for which there is a force
        self._offset_us = 0  # when a position without delay arrives, minus its time
        self._heard_us = 0

    def receive(self, line: PromisedLine, now_us: int) -> None:
        """Follow a line that has arrived."""
        offset_us = now_us - line.t_us
        # A clock that jumped, or a forged time: begin again, or it would rule for as long as it jumped.
        jumped = abs(offset_us - self._offset_us) > GRACE * LONGEST_SILENCE_US
        if self.line is None or jumped:
            self._answered_us = line.t_us
        else:
            elapsed_us = max(now_us - self._heard_us, 0)
            offset_us = min(offset_us, self._offset_us + elapsed_us // RELAXATION)
        self.line, self._offset_us, self._heard_us = line, offset_us, now_us

    def present_us(self, now_us: int) -> int:
        """Return the time [µs] for which the newest position is to be answered: the present, if it was late."""
        line = self._following()
        late = max(now_us - self._offset_us - line.t_us, 0) // self._period_us
        return max(line.t_us + min(late * self._period_us, LONGEST_SILENCE_US), self._answered_us)

    @property
    def velocity_m_per_s(self) -> Vector:
        """Velocity of the line [m/s]."""
        return self._following().velocity_m_per_s

    def answered(self, t_us: int) -> None:
        """Note that there is a force for a time [µs]."""
        self._answered_us = max(t_us, self._answered_us)

    def next_step_us(self) -> int | None:
        """Return when the scene is to be stepped along the line [µs]; None if that waits for a position."""
        if self.line is None or self.bound is None:
            return None
        steps = (self._answered_us - self.line.t_us) // self._period_us + self.every
        after_us = steps * self._period_us
        return self.line.t_us + after_us + self._offset_us if after_us <= GRACE * LONGEST_SILENCE_US else None

    def due(self, now_us: int) -> PositionSample | None:
        """Return the newest place on the line whose time has come; None if it was answered."""
        step_us = self.next_step_us()
        if step_us is None or now_us < step_us:
            return None
        line = self._following()
        steps = (now_us - self._offset_us - line.t_us) // self._period_us
        t_us = line.t_us + min(steps * self._period_us, int(GRACE * LONGEST_SILENCE_US))
        return PositionSample(t_us, self.at(t_us)) if t_us > self._answered_us else None

    def at(self, t_us: int) -> Vector:
        """Return the place on the line at a time, in the box [m]."""
        place_m = self._following().at(t_us)
        return place_m if self.bound is None else self.bound.nearest(place_m)

    def news(self, bound: StiffnessBound | None, position_m: Vector, *, first: bool) -> bytes | None:
        """Take in what the scene says at a position; return what the master must be told, if anything.

        `first`: whether the master has not been told anything.
        """
        bound = rounded_bound(bound)
        if bound is not None and not bound.contains(position_m):
            bound = None
        known = self.bound
        if not first and (known is bound or (known and bound and known.covers(bound, position_m))):
            return None
        self.bound = bound
        return pack_bound(bound)

    def _following(self) -> PromisedLine:
        assert self.line is not None, "there is no line yet"  # noqa: S101 - the caller's fault, not the peer's
        return self.line
