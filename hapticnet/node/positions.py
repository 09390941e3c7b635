"""Positions at both ends: which ones a master sends, and where its slave assumes the hand to be in between."""

from dataclasses import asdict
from typing import Any, Final

from hapticnet.codec.parts import positions_codec
from hapticnet.codec.positions import Difference, PositionSender, PromisedLine, pack_bound, rounded_bound, unpack_bound
from hapticnet.errors import PeerError
from hapticnet.node.decoders import with_state
from hapticnet.perception import WeberLaw
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.settings import master_idle_below_n
from hapticnet.samples import PositionSample, Vector
from hapticnet.stiffness_bound import LONGEST_SILENCE_US, StiffnessBound
from hapticnet.vectors import magnitude


class Forward:
    """The positions of one master. A session grants them a share of the JND, `law`."""

    def __init__(self, session: MasterSession, law: WeberLaw, axes: int) -> None:
        self._idle_below_n = master_idle_below_n(law)
        self._session = session
        self._axes = axes
        self._every = positions_codec(law).encoder(axes)
        self._sender: PositionSender | None = None
        self._sent = self._ticks = self._due_us = 0

    def begin(self, law: WeberLaw, share: float) -> None:
        """Begin a session that grants positions a share of a JND; 0: every position is sent."""
        self._idle_below_n = master_idle_below_n(law)
        reasons = self._sender.reasons if self._sender is not None else None
        self._sender = PositionSender(law, share) if share else None
        if self._sender is not None and reasons is not None:
            self._sender.reasons = reasons

    def set_bound(self, bound: bytes) -> None:
        """Receive a stiffness bound. Without a valid one, every position is sent."""
        if self._sender is None:
            return
        try:
            self._sender.set_bound(unpack_bound(bound, self._axes))
        except PeerError:
            self._session.payload_was_malformed()
            self._sender.set_bound(None)

    @property
    def is_sparse(self) -> bool:
        """Whether positions are sent only when they matter."""
        return self._sender is not None

    def is_due(self, now_us: int, period_us: int, tick_us: int) -> bool:
        """Return whether a tick is the one nearest to the time [µs] at which the next position is due."""
        if period_us <= tick_us:
            return True
        wait_us = self._due_us - now_us
        if 2 * wait_us > tick_us and wait_us <= period_us:
            return False
        # After missed ticks or a clock that jumped, the positions continue from now.
        self._due_us = (self._due_us if abs(wait_us) <= period_us else now_us) + period_us
        return True

    def send_every(self, now_us: int, position_m: Vector, state: int | None = None, data: bytes = b"") -> None:
        """Send the position of a tick in a session that sends all, after the data of a coupling; see `send`."""
        self._ticks += 1
        payload = self._every.encode(now_us, position_m)
        if payload is not None:
            self._transmit(now_us, data + payload, state)

    def is_idle(self, applied_n: Vector) -> bool:
        """Return whether the force [N] of a session with few positions is so small that a long silence does no harm."""
        return self._sender is not None and magnitude(applied_n) < self._idle_below_n

    def send(
        self,
        now_us: int,
        position_m: Vector,
        applied_n: Vector,
        state: int | None = None,
        difference: Difference | None = None,
    ) -> Vector | None:
        """Send the position of a tick if it matters; return the slave's assumed position of the tool, if on a line."""
        self._ticks += 1
        sender = self._sender
        assert sender is not None, "every position is to be sent"  # noqa: S101 - the caller's fault
        wanted = self._session.wants_position(now_us)
        payload = sender.payload(now_us, position_m, magnitude(applied_n), wanted=wanted, difference=difference)
        if payload is not None and not self._transmit(now_us, payload, state):
            sender.forget()
        return sender.place_m(now_us)

    def _transmit(self, now_us: int, payload: bytes, state: int | None) -> bool:
        """Send a position; return whether the session accepts it."""
        if state is not None:
            payload = with_state(state, payload)
        if not self._session.send_position(now_us, payload):
            return False
        self._sent += 1
        return True

    def report(self) -> dict[str, Any]:
        """Return the report of the positions for JSON."""
        report: dict[str, Any] = {"share": self._sender.share if self._sender else 0.0, "ticks": self._ticks}
        report["sent"] = self._sent
        if self._sender is not None:
            report["reasons"] = asdict(self._sender.reasons)
        return report


GRACE: Final = 1.5
"""Time beyond `LONGEST_SILENCE_US` for which a line is followed: one position may be late. After that the slave is
silent, so that the master notices."""

RELAXATION: Final = 100
"""A position that took longer than earlier ones counts as late. The shortest delay is forgotten at a hundredth of the
elapsed time, so that a lasting change of the delay is followed."""

VELOCITY_STEP_US: Final = 1  # time [µs] between the two steps that give a scene the velocity of a line


class DeadReckoning:
    """The slave's view of one hand."""

    def __init__(self, period_us: int) -> None:
        self.line: PromisedLine | None = None  # the newest line
        # the box in which the line is followed, known to the master or about to be; None: it is not followed
        self.bound: StiffnessBound | None = None
        self.every = 1  # periods between two steps of the scene along the line
        self._period_us = period_us
        self._answered_us = 0  # newest time on the master's clock for which there is a force
        self._offset_us = 0  # when a position without delay arrives, minus its time
        self._heard_us = 0

    def receive(self, line: PromisedLine, now_us: int) -> None:
        """Follow a line that has arrived."""
        offset_us = now_us - line.t_us
        # A clock that jumped, or a forged time: start again, otherwise it would dominate for as long as it jumped.
        jumped = abs(offset_us - self._offset_us) > GRACE * LONGEST_SILENCE_US
        if self.line is None or jumped:
            self._answered_us = line.t_us
        else:
            elapsed_us = max(now_us - self._heard_us, 0)
            offset_us = min(offset_us, self._offset_us + elapsed_us // RELAXATION)
        self.line, self._offset_us, self._heard_us = line, offset_us, now_us

    def present_us(self, now_us: int) -> int:
        """Return the time [µs] for which to answer the newest position: the present, if it was late."""
        line = self._following()
        late = max(now_us - self._offset_us - line.t_us, 0) // self._period_us
        return max(line.t_us + min(late * self._period_us, LONGEST_SILENCE_US), self._answered_us)

    @property
    def arriving_m_per_s(self) -> Vector:
        """Velocity with which the tool arrives where the line starts [m/s], as a scene takes it from two positions."""
        return self._following().arriving_m_per_s(self._period_us)

    def answered(self, t_us: int) -> None:
        """Note that there is a force for a time [µs]."""
        self._answered_us = max(t_us, self._answered_us)

    def next_step_us(self) -> int | None:
        """Return the time of the next step along the line [µs]; None if it waits for a position."""
        if self.line is None or self.bound is None:
            return None
        steps = (self._answered_us - self.line.t_us) // self._period_us + self.every
        after_us = steps * self._period_us
        return self.line.t_us + after_us + self._offset_us if after_us <= GRACE * LONGEST_SILENCE_US else None

    def due(self, now_us: int) -> PositionSample | None:
        """Return the newest due place on the line; None if it was answered."""
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
        """Follow the scene's bound at a position; return the bound that the master needs, if any."""
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
