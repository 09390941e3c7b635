"""The master's end of a session, sans-I/O."""

from collections import deque
from dataclasses import dataclass
from typing import TypeAlias

from hapticnet.errors import PeerError
from hapticnet.protocol.arrivals import LEAP, Arrival
from hapticnet.protocol.messages import (
    REASON_BYTES,
    Close,
    Code,
    Hello,
    Position,
    Refuse,
    Welcome,
    clipped,
    pack_hello,
    unpack_close,
    unpack_force,
    unpack_keepalive,
    unpack_refuse,
    unpack_welcome,
)
from hapticnet.protocol.serial_number import MODULUS, distance, unwrap, wrap
from hapticnet.protocol.settings import Entropy, SessionSettings
from hapticnet.protocol.states import MASTER_TRANSITIONS, MasterState, Trigger
from hapticnet.protocol.stats import Distribution, Traffic
from hapticnet.protocol.wire import Datagram, Kind, pack, pack_body, unpack


@dataclass(frozen=True, slots=True)
class Connected:
    """A session is established, for the first time or after a reconnect."""

    welcome: Welcome


@dataclass(frozen=True, slots=True)
class ForceArrived:
    """A force newer than the one applied; `MasterSession.applied` once it is decoded and held."""

    sequence: int
    t_us: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class HoldConfirmed:
    """The slave received a position and has sent nothing newer than the force applied."""


@dataclass(frozen=True, slots=True)
class LinkStale:
    """Nothing arrived for the age limit."""


@dataclass(frozen=True, slots=True)
class LinkRecovered:
    """A datagram of the session arrived while the link was stale."""


@dataclass(frozen=True, slots=True)
class SessionLost:
    """The slave ended or forgot the session; the master asks for a new one."""

    reason: str


@dataclass(frozen=True, slots=True)
class Ended:
    """The session is over. `refused`: it never began; `reason` and `code` are then the slave's."""

    reason: str
    refused: bool
    code: Code = Code.OTHER


MasterEvent: TypeAlias = Connected | ForceArrived | HoldConfirmed | LinkStale | LinkRecovered | SessionLost | Ended


class MasterSession:
    """Ask for a session, keep it, and ask again when the slave has lost it.

    Parameters
    ----------
    request
        The HELLO to send; its nonce is replaced by a fresh one for each session.
    rng
        Where nonces come from.
    """

    def __init__(self, request: Hello, settings: SessionSettings, rng: Entropy) -> None:
        self.state = MasterState.CONNECTING
        self.sent = Traffic()
        self.received = Traffic()
        self.round_trip = Distribution()
        self._request = request
        self._settings = settings
        self._rng = rng
        self._session = 0
        self._sequence = settings.first_sequence
        self._newest_force: int | None = None
        self._next_try_us: int | None = None
        self._tries_left = settings.close_tries
        self._close_reason = ""
        self._heard_us = 0
        self._outbox: list[bytes] = []
        self._events: deque[MasterEvent] = deque()
        self._new_nonce()

    @property
    def streaming(self) -> bool:
        """Whether positions are sent: while there is a session, stale or not, so that it can recover."""
        return self.state is MasterState.ESTABLISHED or self.state is MasterState.STALE

    def send_position(self, t_us: int, payload: bytes) -> None:
        """Send a position of time `t_us` [µs]; nothing is sent unless `streaming`."""
        if self.streaming:
            self._send(Kind.POSITION, Position(wrap(t_us), self._newest_force, payload))

    def close(self, reason: str, now_us: int) -> None:
        """End the session: send CLOSE until the slave answers or the tries are used up."""
        if self.state in (MasterState.CLOSING, MasterState.CLOSED):
            return
        self._close_reason = clipped(reason, REASON_BYTES)
        if self.state is MasterState.CONNECTING:
            self._end(Trigger.CLOSE, self._close_reason)
            return
        self._move(Trigger.CLOSE)
        self._next_try_us = now_us
        self.tick(now_us)

    def tick(self, now_us: int) -> None:
        """Do what is due: repeat HELLO or CLOSE, declare the link stale."""
        if self.state is MasterState.ESTABLISHED:
            self._heard_us = min(self._heard_us, now_us)  # a clock that went back must not shorten a silence
            if now_us - self._heard_us > self._settings.stale_after_us:
                self._move(Trigger.SILENCE)
                self._events.append(LinkStale())
        elif self.state is MasterState.CONNECTING:
            if self._is_time_to_try(now_us, self._settings.hello_interval_us):
                hello = pack_hello(self._request, self._settings.first_sequence)
                self.sent.add(Kind.HELLO, len(hello))
                self._outbox.append(hello)
        elif self.state is MasterState.CLOSING and self._is_time_to_try(now_us, self._settings.close_interval_us):
            if self._tries_left:
                self._tries_left -= 1
                self._send(Kind.CLOSE, Close(self._close_reason))
            else:
                self._end(Trigger.GAVE_UP, self._close_reason)

    def datagrams_to_send(self) -> list[bytes]:
        """Return the datagrams to send now."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def next_event(self) -> MasterEvent | None:
        """Return the next event, or None."""
        return self._events.popleft() if self._events else None

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        """Process a datagram. Never raises: malformed and stray datagrams are counted."""
        try:
            datagram = unpack(data)
            self._receive(datagram, len(data), now_us)
        except PeerError:
            self.received.add_malformed(len(data))

    def applied(self, force: ForceArrived) -> None:
        """Acknowledge a force from now on, because it is applied."""
        self._newest_force = force.sequence

    def payload_was_malformed(self) -> None:
        """Count a payload that the codec refused. The force is not acknowledged, so the slave repairs it."""
        self.received.malformed += 1

    def _receive(self, datagram: Datagram, size: int, now_us: int) -> None:
        kind = datagram.kind
        if self.state is MasterState.CLOSED:
            self._count_stray(kind, size)
            return
        if kind is Kind.WELCOME or kind is Kind.REFUSE:
            self._receive_answer(datagram, size, now_us)
            return
        if datagram.session != self._session or self._session == 0:
            self._count_stray(kind, size)
            return
        if kind is Kind.RESET:
            if not 0 < distance(self._sequence, datagram.sequence) <= LEAP:  # it answers nothing that was sent
                self._count_stray(kind, size)
                return
            self.received.add(kind, size)
            self._reconnect(Trigger.RESET, "the slave does not know the session", now_us)
            return
        if kind is Kind.FORCE:
            force = unpack_force(datagram.body)
            self.received.add(kind, size)
            arrival = self._note_arrival(datagram.sequence, now_us)
            if arrival is Arrival.NEW or (arrival is Arrival.LATE and self._is_news(datagram.sequence)):
                t_us = self._account_round_trip(force.t_us, now_us)
                self._events.append(ForceArrived(datagram.sequence, t_us, force.payload))
        elif kind is Kind.KEEPALIVE:
            keepalive = unpack_keepalive(datagram.body)
            self.received.add(kind, size)
            if self._note_arrival(datagram.sequence, now_us) is Arrival.NEW:
                self._account_round_trip(keepalive.t_us, now_us)
                if keepalive.newest_force == self._newest_force:
                    self._events.append(HoldConfirmed())
        elif kind is Kind.CLOSE:
            close = unpack_close(datagram.body)
            self.received.add(kind, size)
            if self.state is MasterState.CLOSING:
                self._end(Trigger.PEER_CLOSED, self._close_reason)
            elif close.code is Code.FAILED:
                self._move(Trigger.CLOSE)
                self._end(Trigger.PEER_CLOSED, f"the slave closed: {close.reason}", code=close.code)
            else:
                self._reconnect(Trigger.PEER_CLOSED, f"the slave closed: {close.reason}", now_us)
        else:
            self._count_stray(kind, size)

    def _receive_answer(self, datagram: Datagram, size: int, now_us: int) -> None:
        is_welcome = datagram.kind is Kind.WELCOME
        answer = unpack_welcome(datagram.body) if is_welcome else unpack_refuse(datagram.body)
        if is_welcome and not datagram.session:
            raise PeerError("WELCOME without a session")
        self.received.add(datagram.kind, size)
        if answer.nonce != self._request.nonce:
            self.received.stray += 1
        elif self.state is not MasterState.CONNECTING:
            self.received.duplicate += 1
        elif isinstance(answer, Refuse):
            self._end(Trigger.REFUSED, answer.reason, refused=True, code=answer.code)
        else:
            self._session = datagram.session
            self._sequence = wrap(self._settings.first_sequence + 1)
            self._newest_force = None
            self._heard_us = now_us
            self.received.open_window(datagram.sequence)
            self._move(Trigger.WELCOMED)
            self._events.append(Connected(answer))

    def _is_news(self, sequence: int) -> bool:
        """Return whether a late FORCE is newer than the one applied: only KEEPALIVEs or refused FORCEs overtook it."""
        return self._newest_force is None or distance(sequence, self._newest_force) > 0

    def _note_arrival(self, sequence: int, now_us: int) -> Arrival:
        """Account for a sequence number. Old datagrams, too, prove the link alive."""
        self._heard_us = now_us
        if self.state is MasterState.STALE:
            self._move(Trigger.HEARD)
            self._events.append(LinkRecovered())
        return self.received.arrive(sequence)

    def _account_round_trip(self, echoed_t_us: int, now_us: int) -> int:
        """Return the unwrapped time [µs] of the position that was answered."""
        t_us = unwrap(echoed_t_us, now_us)
        self.round_trip.add(now_us - t_us)
        return t_us

    def _reconnect(self, trigger: Trigger, reason: str, now_us: int) -> None:
        if self.state is MasterState.CLOSING:
            self._end(trigger, self._close_reason)
            return
        self._move(trigger)
        self._session = 0
        self._new_nonce()
        self._next_try_us = now_us
        self._events.append(SessionLost(reason))

    def _end(self, trigger: Trigger, reason: str, *, refused: bool = False, code: Code = Code.OTHER) -> None:
        self._move(trigger)
        self._events.append(Ended(reason, refused=refused, code=code))

    def _count_stray(self, kind: Kind, size: int) -> None:
        self.received.add(kind, size)
        self.received.stray += 1

    def _is_time_to_try(self, now_us: int, interval_us: int) -> bool:
        if self._next_try_us is not None and self._next_try_us - interval_us <= now_us < self._next_try_us:
            return False
        self._next_try_us = now_us + interval_us
        return True

    def _send(self, kind: Kind, message: Position | Close) -> None:
        datagram = pack(kind, self._session, self._sequence, pack_body(message))
        self._sequence = wrap(self._sequence + 1)
        self.sent.add(kind, len(datagram))
        self._outbox.append(datagram)

    def _new_nonce(self) -> None:
        self._request = self._request._replace(nonce=int(self._rng.integers(0, MODULUS)))

    def _move(self, trigger: Trigger) -> None:
        self.state = MASTER_TRANSITIONS[self.state, trigger]
