"""The slave's end of one session, sans-I/O. `node.slave` holds the table of all sessions."""

from hapticnet.protocol.arrivals import Arrival
from hapticnet.protocol.messages import (
    REASON_BYTES,
    Close,
    Code,
    Force,
    Hello,
    Keepalive,
    Position,
    Welcome,
    clipped,
    unpack_close,
    unpack_position,
)
from hapticnet.protocol.repair import Repair
from hapticnet.protocol.serial_number import unwrap, wrap
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SLAVE_TRANSITIONS, SlaveState, Trigger
from hapticnet.protocol.stats import Traffic
from hapticnet.protocol.wire import Datagram, Kind, pack, pack_body


class SlaveSession:
    """Sort a master's positions and number the forces that answer them.

    Parameters
    ----------
    number
        The session's number, never 0.
    hello, first_sequence
        The HELLO that opened it, and its sequence number.
    """

    def __init__(
        self, number: int, hello: Hello, settings: SessionSettings, *, first_sequence: int, now_us: int
    ) -> None:
        self.number = number
        self.hello = hello
        self.state = SlaveState.HALF_OPEN
        self.sent = Traffic()
        self.received = Traffic()
        self.received.open_window(first_sequence)
        self.end_reason: str | None = None
        self._settings = settings
        self._sequence = wrap(settings.first_sequence + 1)
        self._newest_force: int | None = None
        self._position_t_us: int | None = None
        self._heard_us = now_us
        self._spoke_us = now_us
        self._repair = Repair()

    def welcome(self, rate_hz: float, scene: str, now_us: int) -> bytes:
        """Return the WELCOME: the same one for a repeated HELLO, which also shows that the master is alive."""
        self._heard_us = now_us
        message = Welcome(self.hello.nonce, rate_hz, self._settings.keepalive_us, scene)
        datagram = pack(Kind.WELCOME, self.number, self._settings.first_sequence, pack_body(message))
        self.sent.add(Kind.WELCOME, len(datagram))
        return datagram

    def receive(self, datagram: Datagram, size: int, now_us: int) -> Position | None:
        """Process a datagram of this session; return its position if that is the newest one.

        The position's time stamp comes back unwrapped. A CLOSE moves the session to CLOSED.

        Raises
        ------
        PeerError
            If the body is malformed; the caller counts it.
        """
        if datagram.kind is Kind.POSITION:
            position = unpack_position(datagram.body)
            self.received.add(datagram.kind, size)
            self._heard_us = now_us
            if self.received.arrive(datagram.sequence) is not Arrival.NEW:
                return None
            if self.state is SlaveState.HALF_OPEN:
                self._move(Trigger.POSITION)
            if position.newest_force is not None:
                self._repair.acknowledged(position.newest_force, now_us)
            near = position.t_us if self._position_t_us is None else self._position_t_us
            self._position_t_us = unwrap(position.t_us, near)
            return Position(self._position_t_us, position.newest_force, position.payload)
        if datagram.kind is Kind.CLOSE:
            close = unpack_close(datagram.body)
            self.received.add(datagram.kind, size)
            self.end(Trigger.PEER_CLOSED, f"the master closed: {close.reason}")
        else:
            self.received.add(datagram.kind, size)
            self.received.stray += 1
        return None

    def expire_update(self, now_us: int) -> bool:
        """Return whether a force is believed lost, so that the current one must be sent now."""
        return self._repair.expire(now_us)

    @property
    def recovering(self) -> bool:
        """Whether a force is believed lost and none sent since is acknowledged: each must then need no earlier one."""
        return self._repair.recovering

    def force(self, t_us: int, payload: bytes, now_us: int) -> bytes:
        """Return a FORCE that answers the position of time `t_us`."""
        self._newest_force = self._sequence
        self._repair.sent(self._sequence, now_us)
        return self._datagram(Kind.FORCE, Force(wrap(t_us), payload), now_us)

    def keepalive_is_due(self, now_us: int) -> bool:
        """Return whether the master has gone without a datagram for the keepalive interval."""
        # A clock that went back must not silence the slave until it has caught up.
        return not 0 <= now_us - self._spoke_us < self._settings.keepalive_us

    def keepalive(self, t_us: int, now_us: int) -> bytes:
        """Return a KEEPALIVE that answers the position of time `t_us`."""
        return self._datagram(Kind.KEEPALIVE, Keepalive(wrap(t_us), self._newest_force), now_us)

    def close(self, reason: str, now_us: int, code: Code = Code.OTHER) -> bytes:
        """Return a CLOSE."""
        return self._datagram(Kind.CLOSE, Close(clipped(reason, REASON_BYTES), code), now_us)

    def silent_us(self, now_us: int) -> int:
        """Return how long nothing has arrived [µs]."""
        return now_us - self._heard_us

    def expires_us(self) -> int:
        """Return when the session expires if nothing arrives until then [µs]."""
        half_open = self.state is SlaveState.HALF_OPEN
        return self._heard_us + (self._settings.half_open_us if half_open else self._settings.idle_after_us)

    def end(self, trigger: Trigger, reason: str) -> None:
        """Move to CLOSED."""
        self._move(trigger)
        self.end_reason = reason

    def _datagram(self, kind: Kind, message: Force | Keepalive | Close, now_us: int) -> bytes:
        datagram = pack(kind, self.number, self._sequence, pack_body(message))
        self._sequence = wrap(self._sequence + 1)
        self._spoke_us = now_us
        self.sent.add(kind, len(datagram))
        return datagram

    def _move(self, trigger: Trigger) -> None:
        self.state = SLAVE_TRANSITIONS[self.state, trigger]
