"""The master's end of a session, sans-I/O."""

from collections import deque
from typing import Final

from hapticnet.errors import PeerError
from hapticnet.outlook import LONGEST_SILENCE_US
from hapticnet.protocol.arrivals import Arrival, ArrivalWindow
from hapticnet.protocol.asking import Asking, Granted
from hapticnet.protocol.events import (
    ChangeRefused,
    Connected,
    Ended,
    ForceArrived,
    Hinted,
    HoldConfirmed,
    LinkRecovered,
    LinkStale,
    MasterEvent,
    Noticed,
    OutlookArrived,
    Refused,
    SessionLost,
)
from hapticnet.protocol.freshness import Freshness
from hapticnet.protocol.keys import MasterKey
from hapticnet.protocol.loss import REPORT_EVERY, LossEstimate
from hapticnet.protocol.messages import (
    REASON_BYTES,
    Close,
    Code,
    Force,
    Grant,
    Position,
    Request,
    clipped,
    pack_position,
    unpack_close,
    unpack_force,
    unpack_keepalive,
    unpack_notice,
)
from hapticnet.protocol.seal import LAST_SEQUENCE, Seal
from hapticnet.protocol.serial_number import MOST, distance, wrap
from hapticnet.protocol.settings import IDLE_KEEPALIVES, SPARSE_KEEPALIVES, Entropy, SessionSettings
from hapticnet.protocol.states import MASTER_TRANSITIONS, MasterState, Trigger
from hapticnet.protocol.stats import Distribution, Traffic
from hapticnet.protocol.wire import OPEN, SEALED, Datagram, Kind, pack, pack_body, unpack

RECENT: Final = 1 << 15
"""A RESET must name one of so many newest sequence numbers; half a minute at 1 kHz. A sealed session ends as many
before its last number."""

DOUBT_MARGIN_US: Final = 10_000
"""How much longer [µs] than a keepalive interval the slave must be silent before a RESET is believed."""

STALE_GROWTH: Final = 1.25
"""By how much each interval between positions is longer than the last while the link is stale."""


class _Parting:
    """The session before the present one: what is on its way is still felt."""

    __slots__ = ("newest_force", "number", "seal", "window")

    def __init__(self, number: int, seal: Seal | None, window: ArrivalWindow, newest_force: int | None) -> None:
        self.number = number
        self.seal = seal
        self.window = window
        self.newest_force = newest_force


class MasterSession:
    """Keep a session with the slave: ask for it, number the positions, sort the forces, notice silence.

    What is not authenticated never ends a session. It makes the master ask for a new one, and the old session goes on
    until that is proved. Forces of the old session count until the first of the new one is applied: they answer
    positions that were sent before the change, which may be a second ago. The owner sets `idle` while no force is felt
    in a session with few positions: silences may then be longer.

    Parameters
    ----------
    key
        This master's key and the slave's public key, for sealed sessions; None for open ones.

    Attributes
    ----------
    events
        What has happened since the owner took the last event out, oldest first.
    position_share
        Share of the JND that positions may use in this session; 0: every position is to be sent.
    """

    def __init__(self, request: Request, settings: SessionSettings, rng: Entropy, key: MasterKey | None = None) -> None:
        self.state = MasterState.CONNECTING
        self.sent = Traffic()
        self.received = Traffic()
        self.round_trip = Distribution()
        self.idle = False
        self._settings = settings
        self._version = OPEN if key is None else SEALED
        self._asking = Asking(request, settings, rng, key)
        self._asking.begin(None)
        self._grant: Grant | None = None
        self.position_share = 0.0
        self._replaced: Request | None = None  # what was asked for before a change that is not granted yet
        self._session = 0
        self._seal: Seal | None = None
        self._parting: _Parting | None = None
        self._sequence = settings.first_sequence
        self._newest_force: int | None = None
        self._confirmed: int | None = None  # the newest force, or a KEEPALIVE since that confirmed it
        self._loss = LossEstimate(settings.first_sequence)
        self._positions = 0
        self._to_acknowledge_us: int | None = None  # since when something waits to be acknowledged
        self._fresh = Freshness(settings.max_age_us)
        self._doubted = False  # a RESET arrived, and nothing fresh since
        self._stale_us = 0
        self._told_slow = False
        self._stale_interval_us = 0.0
        self._next_stale_us = 0
        self._noticed: set[Code] = set()
        self._next_close_us: int | None = None
        self._tries_left = settings.close_tries
        self._close_reason = ""
        self._outbox: list[bytes] = []
        self.events: deque[MasterEvent] = deque()

    @property
    def streaming(self) -> bool:
        """Whether positions are sent: while there is a session, stale or not, so that it can recover."""
        return self.state is _ESTABLISHED or self.state is _STALE

    @property
    def sealed(self) -> bool:
        """Whether sessions are sealed."""
        return self._version == SEALED

    def wants_position(self, now_us: int) -> bool:
        """Return whether a position is due that acknowledges what has arrived, or because the link is stale."""
        if self.state is MasterState.STALE:
            return True
        since_us = self._to_acknowledge_us
        return since_us is not None and not 0 <= now_us - since_us < self._settings.ack_delay_us

    def send_position(self, t_us: int, payload: bytes) -> bool:
        """Send a position of time `t_us` [µs], less often while the link is stale; nothing unless `streaming`.

        Return whether it was sent.
        """
        state = self.state
        if state is _STALE:
            if 0 < self._next_stale_us - t_us <= self._settings.stale_interval_us:
                return False
            self._stale_interval_us = min(STALE_GROWTH * self._stale_interval_us, self._settings.stale_interval_us)
            self._next_stale_us = t_us + round(self._stale_interval_us)
        elif state is not _ESTABLISHED:
            return False
        self._fresh.newest_t_us = t_us
        self._positions += 1
        self._to_acknowledge_us = None
        is_report = self.position_share or not self._positions % REPORT_EVERY
        loss = self._loss.estimate() if is_report else None
        if loss is None:
            # As `pack_position`, without an object in between.
            body = pack_body((t_us & MOST, self._confirmed, payload))
        else:
            body = pack_position(Position(wrap(t_us), self._confirmed, payload, loss))
        self._send(_POSITION, body)
        return True

    def change(self, request: Request) -> None:
        """Ask for a session with another codec, JND or rate. The present one goes on until that is granted.

        The new session goes on with the scene. If it is refused, `ChangeRefused` says why.
        """
        if self.state in (MasterState.CLOSING, MasterState.CLOSED):
            return
        before = self._asking.ask_for(request)
        if self._grant is not None:
            self._replaced = self._replaced or before
            self._asking.begin(self._grant.ticket)

    def close(self, reason: str, now_us: int) -> None:
        """End the session: send CLOSE until the slave answers or the tries are used up."""
        if self.state in (MasterState.CLOSING, MasterState.CLOSED):
            return
        self._asking.stop()
        self._close_reason = clipped(reason, REASON_BYTES)
        if self.state is MasterState.CONNECTING:
            self._end(Trigger.CLOSE, self._close_reason)
            return
        self._move(Trigger.CLOSE)
        self._next_close_us = now_us
        self.tick(now_us)

    def tick(self, now_us: int) -> None:
        """Do what is due: ask for a session, declare the link stale, repeat CLOSE."""
        if (  # the common case, kept short: every position waits for this
            self.state is _ESTABLISHED
            and 0 <= now_us - self._fresh.heard_us <= self._settings.keepalive_us
            and not self._asking.under_way
            and self._sequence <= LAST_SEQUENCE - RECENT
        ):
            return
        if self.state is MasterState.CLOSING:
            self._repeat_close(now_us)
            return
        if self.streaming:
            if self.state is MasterState.ESTABLISHED and self._fresh.silent_us(now_us) > self._stale_after_us:
                self._go_stale(now_us)
            if self._needs_another(now_us):
                self._asking.begin(self._grant.ticket if self._grant else None)
        hello = self._asking.tick(now_us)
        if hello is not None:
            self._send_hello(hello)

    def datagrams_to_send(self) -> list[bytes]:
        """Return the datagrams to send now."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def next_event(self) -> MasterEvent | None:
        """Return the next event, or None."""
        return self.events.popleft() if self.events else None

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        """Process a datagram. Never raises: malformed and stray datagrams are counted."""
        try:
            datagram = unpack(data)
            if self.state is MasterState.CLOSED:
                self._count_stray(datagram.kind, len(data))
            elif datagram.kind in _ANSWERS:
                self._receive_answer(datagram, len(data), now_us)
            elif datagram.version != self._version or not datagram.session:
                self._count_stray(datagram.kind, len(data))
            elif datagram.session != self._session:
                self._receive_parting(datagram, data, now_us)
            elif datagram.kind is Kind.RESET:
                self._receive_reset(datagram, len(data))
            else:
                body = datagram.body if self._seal is None else self._seal.open(data, datagram)
                self._receive(datagram, body, len(data), now_us)
        except PeerError:
            self.received.add_malformed(len(data))

    def applied(self, force: ForceArrived) -> None:
        """Acknowledge a force from now on, because it is applied."""
        if force.is_parting:
            return
        self._parting = None
        self._newest_force = force.sequence
        self._acknowledge(force.sequence, self._fresh.heard_us)

    def payload_was_malformed(self) -> None:
        """Count a payload that the codec refused. The force is not acknowledged, so the slave repairs it."""
        self.received.malformed += 1

    def _receive(self, datagram: Datagram, body: bytes, size: int, now_us: int) -> None:
        kind = datagram.kind
        if kind is Kind.FORCE:
            force = unpack_force(body)
            self.received.add(kind, size)
            arrival = self._arrive(datagram.sequence)
            t_us = self._fresh_t_us(force.t_us, arrival, now_us)
            if t_us is None or arrival is Arrival.ASTRAY or arrival is Arrival.DUPLICATE:
                return
            if arrival is Arrival.NEW or self._is_news(datagram.sequence):
                self._hear(arrival, t_us, now_us)
                if arrival is Arrival.NEW and force.outlook is not None:
                    self.events.append(OutlookArrived(force.outlook))
                self.events.append(ForceArrived(datagram.sequence, t_us, force.payload))
        elif kind is Kind.KEEPALIVE:
            keepalive = unpack_keepalive(body)
            self.received.add(kind, size)
            arrival = self._arrive(datagram.sequence)
            t_us = self._fresh_t_us(keepalive.t_us, arrival, now_us)
            if t_us is not None and arrival is Arrival.NEW:
                self._hear(arrival, t_us, now_us)
                if keepalive.outlook is not None:
                    self.events.append(OutlookArrived(keepalive.outlook))
                if _holds(self._newest_force, keepalive.newest_force):
                    if keepalive.outlook is not None or self._loss.estimate() is not None:  # the slave waits for it
                        self._acknowledge(datagram.sequence, now_us)
                    self._confirmed = datagram.sequence
                    self.events.append(HoldConfirmed(t_us))
        elif kind is Kind.CLOSE:
            close = unpack_close(body)
            self.received.add(kind, size)
            if self.received.arrive(datagram.sequence) is Arrival.NEW:
                self._receive_close(close)
        elif kind is Kind.NOTICE:
            notice = unpack_notice(body)
            self.received.add(kind, size)
            if self._arrive(datagram.sequence) in (Arrival.NEW, Arrival.LATE) and notice.code not in self._noticed:
                self._noticed.add(notice.code)
                self.events.append(Noticed(notice.reason, notice.code))
        else:
            self._count_stray(kind, size)

    def _receive_parting(self, datagram: Datagram, data: bytes, now_us: int) -> None:
        """Process a datagram of the session before; of any other, count it."""
        parting, kind = self._parting, datagram.kind
        if parting is None or datagram.session != parting.number or kind not in (Kind.FORCE, Kind.KEEPALIVE):
            self._count_stray(kind, len(data))
            return
        body = datagram.body if parting.seal is None else parting.seal.open(data, datagram)
        answer = unpack_force(body) if kind is Kind.FORCE else unpack_keepalive(body)
        self.received.add(kind, len(data))
        if parting.window.arrive(datagram.sequence) is not Arrival.NEW:
            return
        t_us = self._fresh_t_us(answer.t_us, Arrival.NEW, now_us)
        if t_us is None:
            return
        self._hear(Arrival.NEW, t_us, now_us)
        if isinstance(answer, Force):
            parting.newest_force = datagram.sequence
            self.events.append(ForceArrived(datagram.sequence, t_us, answer.payload, is_parting=True))
        elif _holds(parting.newest_force, answer.newest_force):
            self.events.append(HoldConfirmed(t_us, is_parting=True))

    def _receive_close(self, close: Close) -> None:
        if self.state is MasterState.CLOSING:
            self._end(Trigger.PEER_CLOSED, self._close_reason)
        elif close.code is Code.FAILED:
            self._move(Trigger.CLOSE)
            self._end(Trigger.PEER_CLOSED, f"the slave closed: {close.reason}", code=close.code)
        else:
            self._move(Trigger.PEER_CLOSED)
            self._session = 0
            self._parting = None
            self._asking.begin(self._grant.ticket if self._grant else None)
            self.events.append(SessionLost(f"the slave closed: {close.reason}"))

    def _receive_reset(self, datagram: Datagram, size: int) -> None:
        if not 0 < distance(self._sequence, datagram.sequence) <= RECENT:  # it answers nothing that was sent
            self._count_stray(datagram.kind, size)
            return
        self.received.add(datagram.kind, size)
        if self.state is MasterState.CLOSING:
            self._end(Trigger.RESET, self._close_reason)
        else:
            self._doubted = True

    def _receive_answer(self, datagram: Datagram, size: int, now_us: int) -> None:
        answer = self._asking.receive(datagram, now_us)
        self.received.add(datagram.kind, size)
        if answer is None:
            self.received.stray += 1
        elif isinstance(answer, bytes):
            self._send_hello(answer)
        elif isinstance(answer, Granted):
            self._begin(answer, now_us)
        elif isinstance(answer, Hinted):
            self.events.append(answer)
        elif self._replaced is not None:
            self._asking.ask_for(self._replaced)
            self._replaced = None
            if self.streaming:
                self._asking.stop()
            self.events.append(ChangeRefused(answer.reason, answer.code))
        elif self._grant is None and answer.code is not Code.STOPPING:
            self._end(Trigger.REFUSED, answer.reason, refused=True, code=answer.code)
        else:
            self.events.append(Refused(answer.reason, answer.code, self._asking.refused(now_us)))

    def _begin(self, granted: Granted, now_us: int) -> None:
        """Use a session that was granted; whatever was used before ends here."""
        grant, seal, sequence = granted
        self._asking.granted()
        self._grant = grant
        self.position_share = grant.position_share
        self._replaced = None
        window = self.received.window
        if self._session and self._newest_force is not None and window is not None:
            self._parting = _Parting(self._session, self._seal, window, self._newest_force)
        self._session = grant.session
        self._seal = seal
        self._sequence = wrap(self._settings.first_sequence + 1)
        self._newest_force = self._confirmed = self._to_acknowledge_us = None
        self._loss = LossEstimate(sequence)
        self._fresh.heard(now_us)
        self._fresh.ahead_us = 3 * LONGEST_SILENCE_US // 2 if grant.position_share else 0
        self._doubted = False
        self._noticed.clear()
        self.received.open_window(sequence, authentic=seal is not None)
        self._move(Trigger.WELCOMED)
        self.events.append(Connected(grant))

    def _needs_another(self, now_us: int) -> bool:
        """Return whether a new session must be asked for while the present one goes on."""
        if self._replaced is not None:
            return True
        silent_us = self._fresh.silent_us(now_us)
        if self._doubted and silent_us > self._keepalive_us + DOUBT_MARGIN_US:
            return True
        wait_us = self._settings.ask_again_us
        # A link that is too slow for this session would be too slow for another.
        if (
            self.state is MasterState.STALE
            and now_us - self._stale_us > wait_us
            and not self._fresh.is_slow(wait_us, now_us)
        ):
            return True
        return self._seal is not None and self._sequence > LAST_SEQUENCE - RECENT

    def _arrive(self, sequence: int) -> Arrival:
        """Account for a sequence number."""
        arrival = self.received.arrive(sequence)
        if arrival is Arrival.NEW or arrival is Arrival.LATE:
            self._loss.arrived(sequence, is_new=arrival is Arrival.NEW)
        return arrival

    @property
    def _stale_after_us(self) -> int:
        return self._settings.idle_stale_after_us if self.idle else self._settings.stale_after_us

    @property
    def _keepalive_us(self) -> int:
        """The longest silence to expect from the slave without loss."""
        granted_us = self._settings.keepalive_us if self._grant is None else self._grant.keepalive_us
        if not self.position_share:
            return granted_us
        return (IDLE_KEEPALIVES if self.idle else SPARSE_KEEPALIVES) * granted_us

    def _acknowledge(self, sequence: int, now_us: int) -> None:
        self._confirmed = sequence
        if self._to_acknowledge_us is None:
            self._to_acknowledge_us = now_us

    def _is_news(self, sequence: int) -> bool:
        """Return whether a late FORCE is newer than the one applied: only KEEPALIVEs or refused FORCEs overtook it."""
        return self._newest_force is None or distance(sequence, self._newest_force) > 0

    def _fresh_t_us(self, echoed_t_us: int, arrival: Arrival, now_us: int) -> int | None:
        """Return the time [µs] of the position that is answered; None, and count it, if the answer is not fresh."""
        t_us = self._fresh.fresh_t_us(echoed_t_us, now_us, is_new=arrival is Arrival.NEW)
        if t_us is None:
            self.received.too_old += 1
            if self.state is MasterState.STALE and self._fresh.too_old_us is not None:
                if not self._told_slow:
                    self._told_slow = True
                    self.events.append(LinkStale(self._fresh.too_old_us))
                if self._asking.under_way and not self._needs_another(now_us):
                    self._asking.stop()
        return t_us

    def _hear(self, arrival: Arrival, t_us: int, now_us: int) -> None:
        """Note an answer that is fresh; only one newer than all before shows that the link is alive."""
        self.round_trip.add(now_us - t_us)
        if arrival is not Arrival.NEW:
            return
        self._fresh.heard(now_us)
        self._doubted = False
        if self.state is MasterState.STALE:
            self._move(Trigger.HEARD)
            self.events.append(LinkRecovered())
        if self._asking.under_way and not self._needs_another(now_us):
            self._asking.stop()

    def _go_stale(self, now_us: int) -> None:
        self._move(Trigger.SILENCE)
        self._stale_us = now_us
        self._stale_interval_us = 1000.0
        self._next_stale_us = now_us
        self._told_slow = self._fresh.too_old_us is not None
        self.events.append(LinkStale(self._fresh.too_old_us))

    def _repeat_close(self, now_us: int) -> None:
        interval_us = self._settings.close_interval_us
        if self._next_close_us is not None and self._next_close_us - interval_us <= now_us < self._next_close_us:
            return
        self._next_close_us = now_us + interval_us
        if self._tries_left:
            self._tries_left -= 1
            self._send(Kind.CLOSE, pack_body(Close(self._close_reason)))
        else:
            self._end(Trigger.GAVE_UP, self._close_reason)

    def _end(self, trigger: Trigger, reason: str, *, refused: bool = False, code: Code = Code.OTHER) -> None:
        self._asking.stop()
        self._move(trigger)
        self.events.append(Ended(reason, refused=refused, code=code))

    def _count_stray(self, kind: Kind, size: int) -> None:
        self.received.add(kind, size)
        self.received.stray += 1

    def _send_hello(self, hello: bytes) -> None:
        self.sent.add(Kind.HELLO, len(hello))
        self._outbox.append(hello)

    def _send(self, kind: Kind, body: bytes) -> None:
        if self._seal is None:
            datagram = pack(kind, self._session, self._sequence, body)
        elif self._sequence > LAST_SEQUENCE:  # no new session in time: a number must not come twice under one key
            return
        else:
            datagram = self._seal.pack(kind, self._session, self._sequence, body)
        self._sequence = (self._sequence + 1) & MOST
        self.sent.add(kind, len(datagram))
        self._outbox.append(datagram)

    def _move(self, trigger: Trigger) -> None:
        self.state = MASTER_TRANSITIONS[self.state, trigger]


def _holds(applied: int | None, named: int | None) -> bool:
    """Return whether a KEEPALIVE that names a FORCE confirms what is applied: that FORCE or one after it."""
    if named is None or applied is None:
        return named is applied
    return distance(applied, named) >= 0


# Found faster than the members, for what every tick asks for.
_ESTABLISHED: Final = MasterState.ESTABLISHED
_STALE: Final = MasterState.STALE
_POSITION: Final = Kind.POSITION

_ANSWERS: Final = frozenset((Kind.COOKIE, Kind.WELCOME, Kind.REFUSE))
"""Kinds that answer a HELLO."""
