"""The slave's end of one session, sans-I/O. `node.slave` holds the table of all sessions."""

from collections.abc import Callable
from typing import Final, TypeVar

from hapticnet.protocol.buckets import TokenBucket
from hapticnet.protocol.messages import (
    REASON_BYTES,
    Close,
    Code,
    Force,
    Keepalive,
    Notice,
    Request,
    Vibration,
    Welcome,
    clipped,
    pack_answer,
    pack_contents,
    unpack_close,
    unpack_notice,
    unpack_position,
)
from hapticnet.protocol.repair import Repair
from hapticnet.protocol.seal import LAST_SEQUENCE, Seal
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SLAVE_TRANSITIONS, SlaveState, Trigger
from hapticnet.protocol.stats import Arrival, RoundTrip, Traffic
from hapticnet.protocol.wire import OPEN, SEALED, Datagram, Kind, distance, pack, pack_body, unwrap, wrap
from hapticnet.samples import Vector

Place = TypeVar("Place")  # content of a position's payload
LOOKED_AT_US: Final = 3_000_000  # after this time [µs] without asking, a master looks at the scene no longer
POLICED_SHARE: Final = 1.2  # positions a second that are served, over the granted rate: allowance for differing clocks
POLICED_BURST_S: Final = 1.0
"""Positions that a network may hold back and deliver at once, in seconds of the granted rate."""

# Faster to look up than the enum members, for every position.
_POSITION: Final = Kind.POSITION
_NEW: Final = Arrival.NEW
_HALF_OPEN: Final = SlaveState.HALF_OPEN


class SlaveSession:
    """Sort a master's positions (few if `sparse`), and number the forces that answer them."""

    def __init__(
        self,
        number: int,
        request: Request,
        settings: SessionSettings,
        *,
        rate_hz: float,
        first_sequence: int,
        now_us: int,
        sparse: bool = False,
    ) -> None:
        self.number = number
        self.request = request
        self.seal: Seal | None = None
        self.version = OPEN
        self.state = SlaveState.HALF_OPEN
        self.sent = Traffic()
        self.received = Traffic()
        self.end_reason: str | None = None
        self.in_step = False  # whether the master had the newest FORCE when it sent the newest position
        self._first_sequence = first_sequence
        self._settings = settings
        self._sequence = wrap(settings.first_sequence + 1)
        self._newest_force: int | None = None
        self._bound: bytes | None = None  # stiffness bound to send until the master acknowledges it
        self._sent_since: int | None = None  # the first datagram with it
        self._position_t_us = request.clock_us
        self.heard_us = now_us
        self._looked_at_us: int | None = None
        self.repair = Repair(settings, request.law(), now_us, sparse=sparse)
        self.round_trip = RoundTrip()
        self._policed = TokenBucket(POLICED_SHARE * rate_hz, max(32.0, POLICED_BURST_S * rate_hz))

    def welcome(self, nonce: int, answer: bytes, seal: Seal | None) -> bytes:
        """Return the WELCOME with a grant, open or sealed, and use `seal` from now on."""
        self.seal = seal
        self.version = OPEN if seal is None else SEALED
        self.received.open_window(self._first_sequence, authentic=seal is not None)
        body = pack_body(Welcome(nonce, answer))
        return pack(Kind.WELCOME, self.number, self._settings.first_sequence, body, self.version)

    def receive(
        self, datagram: Datagram, data: bytes, now_us: int, read: Callable[[bytes], Place]
    ) -> tuple[int, Place] | None:
        """Process a datagram of this session; return the time and place of its position if it is the newest.

        The time stamp [µs] is unwrapped, the place is what `read` returns for the payload. A CLOSE moves the
        session to CLOSED. Raise PeerError if the body cannot be opened, or is malformed; then nothing has
        changed, and the caller counts it.
        """
        body = datagram.body
        received = self.received
        if self.seal is not None:
            body = self.seal.open(data, datagram)
            if self._sequence > LAST_SEQUENCE - 2:  # no sequence numbers left for answers
                received.add(datagram.kind, len(data))
                received.stray += 1
                return None
        if datagram.kind is _POSITION:
            t_us, newest, payload, loss, waited_ms = unpack_position(body)
            place = read(payload)  # the last step that can fail
            received.add(_POSITION, len(data))
            if received.arrive(datagram.sequence) is not _NEW:
                return None
            if not self._policed.take(now_us):  # after dropping copies, so that a replay cannot use up the rate
                received.over_rate += 1
                return None
            # Approximate present time of the master's clock: time stamps wrap, and a silent session may be older.
            clock_us = self._position_t_us
            if now_us > self.heard_us:
                clock_us += now_us - self.heard_us
            self.heard_us = now_us
            if self.state is _HALF_OPEN:
                self._move(Trigger.POSITION)
            self.in_step = False
            if newest is not None:
                self.round_trip.named(newest, now_us - 1000 * waited_ms)
                if self._sent_since is not None:
                    self._note_bound_known(newest)
                self.repair.acknowledged(newest, now_us)
                force = self._newest_force
                self.in_step = force is not None and (newest == force or distance(newest, force) >= 0)
            if loss is not None:
                self.repair.reported(loss, now_us)
            self._position_t_us = t_us = unwrap(t_us, clock_us)
            return t_us, place
        if datagram.kind is Kind.CLOSE:
            close = unpack_close(body)
            self.received.add(datagram.kind, len(data))
            if self.received.arrive(datagram.sequence) is Arrival.NEW:
                self.end(Trigger.PEER_CLOSED, f"the master closed: {close.reason}")
        elif datagram.kind is Kind.NOTICE:
            notice = unpack_notice(body)
            self.received.add(datagram.kind, len(data))
            if self.received.arrive(datagram.sequence) is Arrival.NEW and notice.code is Code.SHAPES:
                self._looked_at_us = now_us
        else:
            self.received.add(datagram.kind, len(data))
            self.received.stray += 1
        return None

    def account_hello(self, size: int, welcome_size: int, now_us: int) -> None:
        """Count a HELLO for this half-open session and its WELCOME; it shows that the master is alive."""
        self.received.add(Kind.HELLO, size)
        self.sent.add(Kind.WELCOME, welcome_size)
        self.heard_us = now_us

    def force(self, t_us: int, payload: bytes, now_us: int, *, before: Vector | None, repeated: bool = False) -> bytes:
        """Return a FORCE that answers the position of time `t_us`.

        `before`: the stimulus held if it is lost; None if losing it does no harm.
        `repeated`: whether it is redundant if the previous FORCE arrived.
        """
        sequence = self._sequence
        if not repeated:
            self._newest_force = sequence
        datagram = self._datagram(Kind.FORCE, Force(wrap(t_us), payload, self._bound), now_us)
        self.repair.sent(sequence, now_us, before)
        return datagram

    def keepalive(self, t_us: int, now_us: int, *, held: Vector | None) -> bytes:
        """Return a KEEPALIVE that answers the position of time `t_us` and confirms the held stimulus."""
        self.repair.kept_alive(self._sequence, now_us, held, tells=self._bound is not None)
        return self._datagram(Kind.KEEPALIVE, Keepalive(wrap(t_us), self._newest_force, self._bound), now_us)

    def set_bound(self, bound: bytes) -> None:
        """Add a stiffness bound to every FORCE and KEEPALIVE until one of them is acknowledged."""
        self._bound, self._sent_since = bound, None

    @property
    def has_news(self) -> bool:
        """Whether a stiffness bound waits to be sent."""
        return self._bound is not None and self._sent_since is None

    def close(self, reason: str, now_us: int, code: Code = Code.OTHER) -> bytes:
        """Return a CLOSE."""
        return self._datagram(Kind.CLOSE, Close(clipped(reason, REASON_BYTES), code), now_us)

    def notice(self, reason: str, now_us: int, code: Code, shapes: bytes | None = None) -> bytes:
        """Return a NOTICE."""
        return self._datagram(Kind.NOTICE, Notice(clipped(reason, REASON_BYTES), code, shapes), now_us)

    def is_looked_at(self, now_us: int) -> bool:
        """Return whether the master has asked lately how the scene looks."""
        return self._looked_at_us is not None and 0 <= now_us - self._looked_at_us < LOOKED_AT_US

    def silent_us(self, now_us: int) -> int:
        """Return the time since the last arrival [µs]."""
        heard_us = self.heard_us
        if now_us < heard_us:  # if the clock went back, silence counts from there
            self.heard_us = heard_us = now_us
        return now_us - heard_us

    def expires_us(self) -> int:
        """Return when the session expires if nothing arrives until then [µs]."""
        half_open = self.state is SlaveState.HALF_OPEN
        return self.heard_us + (self._settings.half_open_us if half_open else self._settings.keep_us)

    def end(self, trigger: Trigger, reason: str) -> None:
        """Move to CLOSED."""
        self._move(trigger)
        self.end_reason = reason

    def vibration(self, t_us: int, payload: bytes, before: bytes | None, now_us: int) -> bytes:
        """Return a VIBRATION with the frame that begins at `t_us`, and possibly with the one before it again."""
        return self._datagram(Kind.VIBRATION, Vibration(wrap(t_us), payload, before), now_us)

    def _datagram(self, kind: Kind, message: Force | Keepalive | Vibration | Close | Notice, now_us: int) -> bytes:
        if isinstance(message, Close | Notice):
            body = pack_contents(message)
        elif isinstance(message, Vibration):
            body = pack_answer(message)
        else:
            body = pack_answer(message)
            self.repair.spoke(now_us)  # other acknowledgements do not show that positions arrive
            if self.has_news:
                self._sent_since = self._sequence
            self.round_trip.sent(self._sequence, now_us)
        if self.seal is None:
            datagram = pack(kind, self.number, self._sequence, body)
        else:
            datagram = self.seal.pack(kind, self.number, self._sequence, body)
        self._sequence = wrap(self._sequence + 1)
        self.sent.add(kind, len(datagram))
        return datagram

    def _note_bound_known(self, newest: int) -> None:
        """Note an acknowledgement: every datagram since `_sent_since` carried the bound."""
        since = self._sent_since
        if since is not None and distance(newest, since) >= 0 and distance(self._sequence, newest) > 0:
            self._bound = self._sent_since = None

    def _move(self, trigger: Trigger) -> None:
        self.state = SLAVE_TRANSITIONS[self.state, trigger]
