"""The slave: answers the positions of each master with forces of that master's own scene."""

from collections import deque
from collections.abc import Callable, Hashable, Iterable
from typing import Any, Final

from hapticnet.errors import PeerError
from hapticnet.node.admission import Admission, LineSteps, MakeScene, NoSeatError, RefusalError, SessionTable
from hapticnet.node.events import (
    MasterJoined,
    MasterLeft,
    MasterRefused,
    ScenePaused,
    SceneResumed,
    SceneSaid,
    SlaveEvent,
)
from hapticnet.node.feedback import SceneFailedError
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave_context import SlaveContext
from hapticnet.node.step_times import Clock, StepTimes, no_wait
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.hello_filter import Address, HelloFilter
from hapticnet.protocol.keys import Roster
from hapticnet.protocol.messages import REASON_BYTES, Code, Hello, clipped
from hapticnet.protocol.settings import Entropy
from hapticnet.protocol.states import SlaveState, Trigger
from hapticnet.protocol.stats import Traffic
from hapticnet.protocol.wire import OPEN, SEALED, Datagram, Kind, pack, unpack

NOTICES_AT_ONCE: Final = 20
"""Masters notified at once of the slave's stop: notifying a thousand would delay their forces."""

NOTICE_EVERY_US: Final = 2_000_000  # least time [µs] between two such notices to a master; a datagram may be lost
STOPPING: Final = "this slave is about to stop: end soon, or go on elsewhere"

REPORTS_KEPT: Final = 1000  # most reports kept of ended sessions: one or two megabytes, so that memory is bounded


class SlaveNode:
    """Serve any number of masters, each with its own scene, codec and report.

    `doors`: how to read the HELLOs of each version that is served; open sessions by default.
    `host_of`: returns the host of an address: the identity of open sessions, and the unit of the request limit.
    `clock`: times the steps of scenes and of users' codecs; None: they are not timed.
    """

    def __init__(
        self,
        make_scene: MakeScene,
        settings: SlaveSettings,
        rng: Entropy,
        *,
        doors: dict[int, Door] | None = None,
        write_address: Callable[[Address], str] = str,
        host_of: Callable[[Address], Hashable] = lambda address: address,
        clock: Clock | None = None,
    ) -> None:
        self._write_address = write_address
        self._host_of = host_of
        self.unknown_peers = Traffic()
        self.to_unknown_peers = Traffic()
        self._settings = settings
        self._doors = {OPEN: Door()} if doors is None else doors
        self.hello_filter = HelloFilter(self._doors, rng)
        self.times = StepTimes(clock)
        self._admission = Admission(make_scene, settings, rng, self.times)
        self._table = SessionTable(settings.session)
        self._contexts = self._table.by_number
        self._welcomes: dict[tuple[Address, int], tuple[SlaveContext, bytes]] = {}
        self._steps = LineSteps()
        self._to_notify: list[SlaveContext] = []
        self._notify_us = 0  # time of the next stop notice to all masters
        self._to_answer: list[SlaveContext] = []
        self._to_account: list[SlaveContext] = []
        self.never_used = 0
        self.unread_hello: tuple[str, Address] | None = None  # newest malformed HELLO: why, from where
        self._ended: deque[dict[str, Any]] = deque(maxlen=REPORTS_KEPT)
        self._outbox: list[tuple[bytes, Address]] = []
        self._events: deque[SlaveEvent] = deque()

    @property
    def contexts(self) -> tuple[SlaveContext, ...]:
        """The present sessions."""
        return tuple(self._contexts.values())

    @property
    def session_count(self) -> int:
        """Number of present sessions."""
        return len(self._contexts)

    def totals(self) -> tuple[int, int]:
        """Return the steps of all present sessions, and the datagrams that were sent in them."""
        contexts = self.contexts
        return sum(each.steps for each in contexts), sum(each.session.sent.packets for each in contexts)

    def receive_datagram(self, data: bytes, address: Address, now_us: int) -> None:
        """Process a datagram and answer it. Never raises: malformed and stray datagrams are counted."""
        self.receive_datagrams([(data, address)], now_us)
        self.account_sent(now_us)

    def receive_datagrams(self, batch: Iterable[tuple[bytes, Address]], now_us: int) -> None:
        """Process arrivals, then answer the newest position of each session; send this, then call `account_sent`."""
        self._table.see(now_us)
        for data, address in batch:
            self._receive(data, address, now_us)
        for context in self._to_answer:
            if context.session.state is SlaveState.OPEN:
                self._answer(context, now_us, context.answer)
        self._to_account += self._to_answer
        self._to_answer.clear()

    def account_sent(self, now_us: int) -> None:
        """Account for the answers, once they are sent."""
        for context in self._to_account:
            try:
                context.account_sent()
            except SceneFailedError as failure:
                if context.session.state is SlaveState.OPEN:
                    self._end(context, str(failure), now_us, code=Code.FAILED)
            if context.session.state is SlaveState.OPEN and (notice := context.look(now_us)) is not None:
                self._outbox.append((notice, context.address))  # it goes with the next force
        self._to_account.clear()

    def tick(self, now_us: int) -> None:
        """Forget long silent sessions, and step scenes along lines; send the answers, then call `account_sent`."""
        self._table.see(now_us)
        for context in self._table.expired(now_us):
            self._forget(context, Trigger.IDLE, "nothing arrived from the master")
        for context in self._table.in_order(self._steps.due(now_us)):
            self._answer(context, now_us, context.step_between)
            self._to_account.append(context)

    def check(self, now_us: int, waited_us: Clock = no_wait) -> None:
        """Check whether scenes keep up with positions; call this a few times a second.

        `waited_us` returns the total time [µs] that this thread has waited for a processor.

        Slow code is reported once as an event, and to its masters once a second while it lasts; a message of a scene
        as an event and to its master. After `drain`, the
        masters are notified that the slave is about to stop.
        """
        if self.draining:
            self._tell_stop(now_us)
        news = self.times.check(now_us, waited_us)
        if news is None:
            return
        self._events.extend(news)
        for context in tuple(self._contexts.values()):
            slow = context.slow if context.seated else None
            if slow is not None:
                self._notify(context, str(slow.warning), Code.SLOW, now_us)
            line = context.next_line() if context.seated else None
            if line is not None:
                self._events.append(SceneSaid(context, line))
                self._notify(context, line, Code.OTHER, now_us)

    def drain(self, now_us: int) -> None:
        """Accept no new masters from now on, and notify the present ones; they may finish until `close`."""
        self._admission.takes_new = False
        self._tell_stop(now_us)

    @property
    def draining(self) -> bool:
        """Whether new masters are refused because the slave is about to stop."""
        return not self._admission.takes_new

    @property
    def drained(self) -> bool:
        """Whether all sessions have ended."""
        return not any(context.seated for context in self._contexts.values())

    def next_timer_us(self) -> int | None:
        """Return when `tick` may have something to do [µs]; None if there is no session."""
        expiry_us, step_us = self._table.next_expiry_us(), self._steps.earliest_us()
        if step_us is None or (expiry_us is not None and expiry_us < step_us):
            return expiry_us
        return step_us

    def datagrams_to_send(self) -> list[tuple[bytes, Address]]:
        """Return the datagrams to send now, with their destinations."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def next_event(self) -> SlaveEvent | None:
        """Return the next event, or None."""
        return self._events.popleft() if self._events else None

    def close(self, reason: str, now_us: int) -> None:
        """End every session and send the masters a CLOSE."""
        for context in self.contexts:
            self._end(context, reason, now_us, code=Code.STOPPING)

    def resume(self) -> None:
        """Step failed and paused scenes again."""
        for context in self.contexts:
            if context.paused is not None:
                context.resume()
                self._events.append(SceneResumed(context))

    def serve_only(self, roster: Roster, now_us: int) -> None:
        """Use another list of masters; end the sessions of masters no longer listed."""
        door = self._doors[SEALED]
        assert isinstance(door, SealedDoor)  # noqa: S101 - for the type checker
        door.roster = roster
        served = {entry.public for entry in roster}
        for context in self.contexts:
            if context.session.seal is not None and context.identity not in served:
                self._end(context, "the key is no longer served", now_us, code=Code.KEY)

    def report(self) -> dict[str, Any]:
        """Return the report of present and ended sessions for JSON; those without a seat count as unknown peers."""
        return {
            "sessions": [*self._ended, *(self._report(context) for context in self.contexts if context.seated)],
            "never_used": self.never_used,
            "throttled": self.hello_filter.throttled,
            "unkeyed": self.hello_filter.unkeyed,
            "step_times": self.times.report(),
            "unknown_peers": self.unknown_peers.report(),
            "to_unknown_peers": self.to_unknown_peers.report(),
        }

    def _report(self, context: SlaveContext) -> dict[str, Any]:
        return {"address": self._write_address(context.address), **context.report()}

    def _receive(self, data: bytes, address: Address, now_us: int) -> None:
        account = self.unknown_peers
        try:
            datagram = unpack(data)
            context = self._contexts.get(datagram.session)
            if context is None:
                if datagram.kind is Kind.HELLO:
                    self._receive_hello(datagram, len(data), address, now_us)
                else:
                    self._receive_stray(datagram, len(data), address)
                return
            session = context.session
            if (
                datagram.version != session.version
                or (context.address != address and session.seal is None)
                or (datagram.kind is not Kind.POSITION and datagram.kind not in (Kind.CLOSE, Kind.NOTICE))
            ):
                self._receive_stray(datagram, len(data), address)
                return
            account = session.received
            was_half_open = session.state is SlaveState.HALF_OPEN
            has_position = context.receive(datagram, data, address, now_us)
        except PeerError:
            account.add_malformed(len(data))
            return
        if session.state is SlaveState.CLOSED:
            self._outbox.append((session.close("as asked", now_us), address))
            self._remove(context)
        elif was_half_open and session.state is SlaveState.OPEN and not self._seat(context, now_us):
            return
        elif has_position:
            self._to_answer.append(context)

    def _answer(self, context: SlaveContext, now_us: int, step: Callable[[int], bytes | None]) -> None:
        was_paused = context.paused
        try:
            answer = step(now_us)
            vibrations = context.vibrations(now_us) if context.vibrates else None
        except SceneFailedError as failure:
            self._end(context, str(failure), now_us, code=Code.FAILED)
            return
        if answer is not None:
            self._outbox.append((answer, context.address))
        if vibrations:
            self._outbox += [(data, context.address) for data in vibrations]
        if context.reckoning is not None:  # checked here, to keep the path of a position short
            self._steps.note(context)
        if context.paused is not None and was_paused is None:
            self._events.append(ScenePaused(context, context.paused))

    def _seat(self, context: SlaveContext, now_us: int) -> bool:
        """Give a proved session its seat; return False if none is free."""
        if self._scene_is_taken(context, now_us):
            self._end(context, "the scene that it was to continue is in use again", now_us)
            return False
        besides = () if context.continues is None else (context.continues,)
        try:
            gives_way = self._table.eviction_candidate(context.identity, context.seats, besides, now_us)
        except NoSeatError as error:
            self._end(context, str(error), now_us, code=Code.FULL)
            return False
        if gives_way is not None:
            self._forget(gives_way, Trigger.REPLACED, "its place was needed")
        if context.continues is not None and context.continues.session.state is SlaveState.OPEN:
            context.inherit(context.continues)
            self._forget(context.continues, Trigger.CONTINUED, "its master goes on in a new session")
        self._table.seat(context)
        self._forget_greeting(context)  # its master has the WELCOME, so a repeated HELLO comes from somebody else
        self._events.append(MasterJoined(context))
        return True

    def _scene_is_taken(self, context: SlaveContext, now_us: int) -> bool:
        """Return whether another master has resumed, since the HELLO, the scene that a session was to continue."""
        for other in self._table.users_of(context.scene):
            silent = other.session.silent_us(now_us) > self._settings.session.stale_after_us
            if other is not context.continues or not (silent or context.same_clock):
                return True
        return False

    def _receive_hello(self, datagram: Datagram, size: int, address: Address, now_us: int) -> None:
        admitted = None
        try:
            greeted = self.hello_filter.greet(datagram, size, address, now_us)
            if isinstance(greeted, Hello):
                # A HELLO repeated after a lost answer gets the same answer.
                known = self._welcomes.get((address, greeted.nonce))
                admitted = known or self._admit(datagram, greeted, address, now_us)
        except PeerError as error:
            self.unread_hello = clipped(str(error), REASON_BYTES), address
            raise
        if admitted is not None:
            context, welcome = admitted
            context.session.account_hello(size, len(welcome), now_us)
            self._outbox.append((welcome, address))
            return
        self.unknown_peers.add(Kind.HELLO, size)
        if isinstance(greeted, bytes):
            self._send_to_unknown(greeted, address)

    def _admit(
        self, datagram: Datagram, hello: Hello, address: Address, now_us: int
    ) -> tuple[SlaveContext, bytes] | None:
        """Read the request of a proved address; return the new session and its WELCOME, None if there is none."""
        host = self._host_of(address)
        visitor = self.hello_filter.read(datagram, hello, address, host, now_us)
        if visitor is None:
            return None
        try:
            context = self._admission.admit(visitor, datagram.sequence, address, host, self._table, now_us)
        except RefusalError as refusal:
            self._send_to_unknown(refusal.datagram(visitor, hello.nonce), address)
            name, public = visitor.request.name, visitor.public
            self._events.append(MasterRefused(name, address, public, refusal.code, str(refusal)))
            return None
        welcome = context.session.welcome(hello.nonce, *visitor.answer(context.grant))  # the last step that can fail
        surplus = self._table.surplus_half_open(context.identity)
        if surplus is not None:
            self._forget(surplus, Trigger.REPLACED, "its place was needed")
        context.greeting = address, hello.nonce
        self._welcomes[context.greeting] = context, welcome
        self._table.add(context)
        if context.continues is not None:
            context.continues.add_successor(context)
        return context, welcome

    def _receive_stray(self, datagram: Datagram, size: int, address: Address) -> None:
        """Answer a datagram of an unknown session with RESET, so that its master soon asks for a new one."""
        self.unknown_peers.add(datagram.kind, size)
        self.unknown_peers.stray += 1
        if datagram.kind is Kind.POSITION or datagram.kind is Kind.CLOSE:
            reset = pack(Kind.RESET, datagram.session, datagram.sequence, b"", datagram.version)
            self._send_to_unknown(reset, address)

    def _send_to_unknown(self, data: bytes, address: Address) -> None:
        self.to_unknown_peers.add(unpack(data).kind, len(data))
        self._outbox.append((data, address))

    def _end(self, context: SlaveContext, reason: str, now_us: int, *, code: Code = Code.OTHER) -> None:
        """End a session from this side and notify its master."""
        context.failure = reason if code is Code.FAILED else None
        self._outbox.append((context.session.close(reason, now_us, code), context.address))
        self._forget(context, Trigger.CLOSE, f"the slave closed: {reason}")

    def _tell_stop(self, now_us: int) -> None:
        """Notify some of the masters that the slave is about to stop."""
        if not self._to_notify and now_us >= self._notify_us:
            self._to_notify = [each for each in self._contexts.values() if each.seated]
            self._notify_us = now_us + NOTICE_EVERY_US
        now, self._to_notify = self._to_notify[:NOTICES_AT_ONCE], self._to_notify[NOTICES_AT_ONCE:]
        for context in now:
            if context.session.state is SlaveState.OPEN:
                self._notify(context, STOPPING, Code.STOPPING, now_us)

    def _notify(self, context: SlaveContext, reason: str, code: Code, now_us: int) -> None:
        """Send a master a notice about its continuing session."""
        self._outbox.append((context.session.notice(reason, now_us, code), context.address))

    def _forget(self, context: SlaveContext, trigger: Trigger, reason: str) -> None:
        context.session.end(trigger, reason)
        self._remove(context)

    def _forget_greeting(self, context: SlaveContext) -> None:
        if context.greeting is not None:
            self._welcomes.pop(context.greeting, None)

    def _remove(self, context: SlaveContext) -> None:
        """Remove a session that has ended."""
        self._table.remove(context)
        self._steps.forget(context)
        self._forget_greeting(context)
        if context.seated:
            self._ended.append(self._report(context))
            self._events.append(MasterLeft(context))
        else:
            self.never_used += 1
            self.unknown_peers.absorb(context.session.received)
            self.to_unknown_peers.absorb(context.session.sent)
