"""The master's end of a session, sans-I/O."""

from collections import deque
from typing import Final

from hapticnet.errors import PeerError
from hapticnet.protocol.handshake import Asking, Granted
from hapticnet.protocol.keys import MasterKey
from hapticnet.protocol.master_stream import Freshness, MasterStream, Pace
from hapticnet.protocol.messages import (
    REASON_BYTES,
    Close,
    Code,
    Force,
    Grant,
    Request,
    clipped,
    unpack_close,
    unpack_force,
    unpack_keepalive,
    unpack_notice,
    unpack_vibration,
)
from hapticnet.protocol.settings import IDLE_KEEPALIVES, SPARSE_KEEPALIVES, Entropy, SessionSettings
from hapticnet.protocol.states import (
    MASTER_TRANSITIONS,
    BoundArrived,
    ChangeRefused,
    Connected,
    Ended,
    ForceArrived,
    Hinted,
    HoldConfirmed,
    LinkRecovered,
    LinkStale,
    MasterEvent,
    MasterState,
    Noticed,
    Refused,
    SessionLost,
    Trigger,
    VibrationArrived,
)
from hapticnet.protocol.stats import Arrival, Distribution, Traffic
from hapticnet.protocol.wire import OPEN, SEALED, Datagram, Kind, pack_body, unpack, wrap
from hapticnet.stiffness_bound import LONGEST_SILENCE_US

DOUBT_MARGIN_US: Final = 10_000
"""How much longer [µs] than a keepalive interval the slave must be silent before a RESET is believed."""


class MasterSession:
    """Keep a session with the slave: ask for it, number positions, sort forces, and notice silence.

    Unauthenticated messages never end a session. They make the master ask for a new one, and the old session continues
    until the new one is proved. Forces of the old session count until the first of the new one is applied: they answer
    positions that were sent before the change, up to a second earlier. The owner sets `idle` while next to no
    force is applied in a session with few positions: silences may then be longer.
    """

    def __init__(self, request: Request, settings: SessionSettings, rng: Entropy, key: MasterKey | None = None) -> None:
        self.state = MasterState.CONNECTING
        self.sent = Traffic()
        self.received = Traffic()
        self.drawing = Traffic()  # those of `received` that only show how the scene looks
        self.round_trip = Distribution()
        self.idle = False
        self._settings = settings
        self._version = OPEN if key is None else SEALED
        self._asking = Asking(request, settings, rng, key)
        self._asking.begin(None)
        self._grant: Grant | None = None
        self.position_share = 0.0  # share of the JND for positions; 0: send every position
        self._replaced: Request | None = None  # the request before a change that is not granted yet
        self._stream: MasterStream | None = None
        self._parting: MasterStream | None = None  # the previous session: its forces in flight are still felt
        self._fresh = Freshness(settings.max_age_us)
        self._doubted = False  # a RESET arrived, and nothing fresh since
        self._stale_us = 0
        self._told_slow = False
        self._pace = Pace(settings.stale_interval_us)
        self._noticed: set[Code] = set()
        self._next_close_us: int | None = None
        self._tries_left = settings.close_tries
        self._close_reason = ""
        self._outbox: list[bytes] = []
        self.events: deque[MasterEvent] = deque()  # not fetched yet, oldest first

    @property
    def streaming(self) -> bool:
        """Whether positions are sent: while there is a session, stale or not, so that it can recover."""
        return self.state is _ESTABLISHED or self.state is _STALE

    @property
    def number(self) -> int:
        """Number of the present session; 0: there is none."""
        return 0 if self._stream is None else self._stream.number

    @property
    def sealed(self) -> bool:
        """Whether sessions are sealed."""
        return self._version == SEALED

    def wants_position(self, now_us: int) -> bool:
        """Return whether a position is due that acknowledges what has arrived, or because the link is stale."""
        if self.state is MasterState.STALE:
            return True
        return self._stream is not None and self._stream.owes_since(self._settings.ack_delay_us, now_us)

    def send_position(self, t_us: int, payload: bytes) -> bool:
        """Send a position of time `t_us` [µs], less often in STALE; return whether it was sent. Needs `streaming`."""
        state = self.state
        if state is _STALE:
            if not self._pace.is_due(t_us):
                return False
        elif state is not _ESTABLISHED:
            return False
        self._fresh.newest_t_us = t_us
        stream = self._used
        self._send(stream, _POSITION, stream.body_of_position(t_us, payload))
        return True

    def ask_for_shapes(self) -> None:
        """Ask how the scene looks; to be repeated about once a second, as long as somebody looks at it."""
        if self.streaming:
            self._send(self._used, Kind.NOTICE, pack_body(("", Code.SHAPES)))

    def change(self, request: Request) -> None:
        """Ask for a session with another request, which continues the scene; until then the present one continues."""
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
        """Do the due work: ask for a session, declare the link stale, repeat CLOSE."""
        if (  # the common case, kept short: every position waits for this
            self.state is _ESTABLISHED
            and 0 <= now_us - self._fresh.heard_us <= self._settings.keepalive_us
            and not self._asking.under_way
            and not self._used.wears_out
        ):
            return
        if self.state is MasterState.CLOSING:
            self._repeat_close(now_us)
            return
        if self.streaming:
            stale_after_us = self._settings.stale_after(self.idle)
            if self.state is MasterState.ESTABLISHED and self._fresh.silent_us(now_us) > stale_after_us:
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
            elif datagram.version != self._version:
                self._count_stray(datagram.kind, len(data))
            elif (stream := self._stream) is None or datagram.session != stream.number:
                self._receive_parting(datagram, data, now_us)
            elif datagram.kind is Kind.RESET:
                self._receive_reset(stream, datagram, len(data))
            else:
                self._receive(stream, datagram, stream.open(data, datagram), len(data), now_us)
        except PeerError:
            self.received.add_malformed(len(data))

    def applied(self, force: ForceArrived) -> None:
        """Acknowledge a force from now on, because it is applied."""
        stream = self._stream
        if force.is_parting or stream is None:
            return
        self._parting = None
        stream.newest_force = force.sequence
        stream.acknowledge(force.sequence, self._fresh.heard_us)

    def payload_was_malformed(self) -> None:
        """Count a payload that the codec refused. The force is not acknowledged, so the slave repairs it."""
        self.received.malformed += 1

    def _receive(self, stream: MasterStream, datagram: Datagram, body: bytes, size: int, now_us: int) -> None:
        kind = datagram.kind
        if kind is Kind.FORCE:
            force = unpack_force(body)
            self.received.add(kind, size)
            arrival = self._arrive(stream, datagram.sequence)
            t_us = self._fresh_t_us(force.t_us, arrival, now_us)
            if t_us is None or arrival is Arrival.ASTRAY or arrival is Arrival.DUPLICATE:
                return
            if arrival is Arrival.NEW or stream.is_news(datagram.sequence):
                self._hear(arrival, t_us, now_us)
                if arrival is Arrival.NEW and force.bound is not None:
                    self.events.append(BoundArrived(force.bound))
                self.events.append(ForceArrived(datagram.sequence, t_us, force.payload))
        elif kind is Kind.KEEPALIVE:
            keepalive = unpack_keepalive(body)
            self.received.add(kind, size)
            arrival = self._arrive(stream, datagram.sequence)
            t_us = self._fresh_t_us(keepalive.t_us, arrival, now_us)
            if t_us is not None and arrival is Arrival.NEW:
                self._hear(arrival, t_us, now_us)
                if keepalive.bound is not None:
                    self.events.append(BoundArrived(keepalive.bound))
                if stream.is_confirmed_by(keepalive.newest_force):
                    if keepalive.bound is not None or stream.loss.estimate() is not None:  # the slave waits for it
                        stream.acknowledge(datagram.sequence, now_us)
                    stream.confirm(datagram.sequence, now_us)
                    self.events.append(HoldConfirmed(t_us))
        elif kind is Kind.VIBRATION and self._grant is not None and self._grant.vibration:
            vibration = unpack_vibration(body)
            self.received.add(kind, size)
            arrival = self._arrive(stream, datagram.sequence)
            if arrival is Arrival.NEW or arrival is Arrival.LATE:
                # No sign of life: it neither ends a stale link nor counts among the answers that come too late.
                t_us = self._fresh.fresh_t_us(vibration.t_us, now_us, is_new=False)
                if t_us is None:
                    self.received.too_old += 1
                else:
                    self.events.append(VibrationArrived(t_us, vibration.payload, vibration.before))
        elif kind is Kind.CLOSE:
            close = unpack_close(body)
            self.received.add(kind, size)
            if self.received.arrive(datagram.sequence) is Arrival.NEW:
                self._receive_close(close)
        elif kind is Kind.NOTICE:
            notice = unpack_notice(body)
            self.received.add(kind, size)
            arrival = self._arrive(stream, datagram.sequence)
            if notice.shapes is not None:
                self.drawing.add(kind, size)
                if arrival is Arrival.NEW:  # what is late shows how the scene looked before
                    self.events.append(Noticed("", notice.code, notice.shapes))
            elif arrival in (Arrival.NEW, Arrival.LATE) and notice.code not in self._noticed:
                self._noticed.add(notice.code)
                self.events.append(Noticed(notice.reason, notice.code))
        else:
            self._count_stray(kind, size)

    def _receive_parting(self, datagram: Datagram, data: bytes, now_us: int) -> None:
        """Process a datagram of the previous session; count those of any other."""
        parting, kind = self._parting, datagram.kind
        if parting is None or datagram.session != parting.number or kind not in (Kind.FORCE, Kind.KEEPALIVE):
            self._count_stray(kind, len(data))
            return
        body = parting.open(data, datagram)
        answer = unpack_force(body) if kind is Kind.FORCE else unpack_keepalive(body)
        self.received.add(kind, len(data))
        if parting.window is None or parting.window.arrive(datagram.sequence) is not Arrival.NEW:
            return
        t_us = self._fresh_t_us(answer.t_us, Arrival.NEW, now_us)
        if t_us is None:
            return
        self._hear(Arrival.NEW, t_us, now_us)
        if isinstance(answer, Force):
            parting.newest_force = datagram.sequence
            self.events.append(ForceArrived(datagram.sequence, t_us, answer.payload, is_parting=True))
        elif parting.is_confirmed_by(answer.newest_force):
            self.events.append(HoldConfirmed(t_us, is_parting=True))

    def _receive_close(self, close: Close) -> None:
        if self.state is MasterState.CLOSING:
            self._end(Trigger.PEER_CLOSED, self._close_reason)
        elif close.code is Code.FAILED:
            self._move(Trigger.CLOSE)
            self._end(Trigger.PEER_CLOSED, f"the slave closed: {close.reason}", code=close.code)
        else:
            self._move(Trigger.PEER_CLOSED)
            self._stream = self._parting = None
            self._asking.begin(self._grant.ticket if self._grant else None)
            self.events.append(SessionLost(f"the slave closed: {close.reason}"))

    def _receive_reset(self, stream: MasterStream, datagram: Datagram, size: int) -> None:
        if not stream.sent_lately(datagram.sequence):  # it answers nothing that was sent
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
        """Use a granted session, and end the previous one."""
        grant, seal, sequence = granted
        self._asking.granted()
        self._grant = grant
        self.position_share = grant.position_share
        self._replaced = None
        if self._stream is not None and self._stream.newest_force is not None:
            self._parting = self._stream
        self._stream = stream = MasterStream(
            grant.session,
            seal,
            sequence=wrap(self._settings.first_sequence + 1),
            welcome=sequence,
            sparse=grant.position_share > 0.0,
        )
        self._fresh.heard(now_us)
        self._fresh.ahead_us = 3 * LONGEST_SILENCE_US // 2 if grant.position_share else 0
        self._doubted = False
        self._noticed.clear()
        self.received.open_window(sequence, authentic=seal is not None)
        stream.window = self.received.window
        self._move(Trigger.WELCOMED)
        self.events.append(Connected(grant))

    def _needs_another(self, now_us: int) -> bool:
        """Return whether to ask for a new session while the present one continues."""
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
        return self._used.wears_out

    @property
    def _used(self) -> MasterStream:
        assert self._stream is not None, "there is a session"  # noqa: S101 - the states say so
        return self._stream

    def _arrive(self, stream: MasterStream, sequence: int) -> Arrival:
        """Account for a sequence number."""
        arrival = self.received.arrive(sequence)
        if arrival is Arrival.NEW or arrival is Arrival.LATE:
            stream.loss.arrived(sequence, is_new=arrival is Arrival.NEW)
        return arrival

    @property
    def _keepalive_us(self) -> int:
        """The longest silence to expect from the slave without loss."""
        granted_us = self._settings.keepalive_us if self._grant is None else self._grant.keepalive_us
        if not self.position_share:
            return granted_us
        return (IDLE_KEEPALIVES if self.idle else SPARSE_KEEPALIVES) * granted_us

    def _fresh_t_us(self, echoed_t_us: int, arrival: Arrival, now_us: int) -> int | None:
        """Return the time [µs] of the answered position; None, and count it, if the answer is not fresh."""
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
        self._pace.begin(now_us)
        self._told_slow = self._fresh.too_old_us is not None
        self.events.append(LinkStale(self._fresh.too_old_us))

    def _repeat_close(self, now_us: int) -> None:
        interval_us = self._settings.close_interval_us
        if self._next_close_us is not None and self._next_close_us - interval_us <= now_us < self._next_close_us:
            return
        self._next_close_us = now_us + interval_us
        if self._tries_left:
            self._tries_left -= 1
            self._send(self._used, Kind.CLOSE, pack_body(Close(self._close_reason)))
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

    def _send(self, stream: MasterStream, kind: Kind, body: bytes) -> None:
        datagram = stream.pack(kind, body)
        if datagram is not None:
            self.sent.add(kind, len(datagram))
            self._outbox.append(datagram)

    def _move(self, trigger: Trigger) -> None:
        self.state = MASTER_TRANSITIONS[self.state, trigger]


# Faster to look up than the enum members, which every tick needs.
_ESTABLISHED: Final = MasterState.ESTABLISHED
_STALE: Final = MasterState.STALE
_POSITION: Final = Kind.POSITION

_ANSWERS: Final = frozenset((Kind.COOKIE, Kind.WELCOME, Kind.REFUSE))  # kinds that answer a HELLO
