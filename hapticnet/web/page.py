"""The live page beside a master: takes down each tick, and tells every connected page what there is to see."""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from hapticnet.errors import PeerError
from hapticnet.node.master import MasterNode
from hapticnet.node.master_events import NodeEvent
from hapticnet.operator.live import HandState, LiveHand
from hapticnet.protocol.events import Connected
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.watching import Watcher
from hapticnet.scene.tissue import SceneSettings
from hapticnet.web import messages
from hapticnet.web.controls import Controls
from hapticnet.web.description import Description
from hapticnet.web.messages import CloseCode, Hand, LetGo, MistakeError, Release, Take
from hapticnet.web.seat import Seat
from hapticnet.web.ticks import Ticks
from hapticnet.web.traffic import RecentMedian, TrafficMeter

if TYPE_CHECKING:
    from hapticnet.web.client import Client

MOST_PAGES: Final = 16

NOT_READY_AFTER_US: Final = 1_000_000
"""Time [µs] without a session after which pages are told so; a change of codec takes less."""

INTERVAL_S: Final = 1 / messages.MESSAGES_PER_S

FRAMES_PER_STATE: Final = messages.MESSAGES_PER_S // messages.STATES_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class PageSettings:
    """What a page is about.

    Attributes
    ----------
    source
        Where the positions come from, in a word: page, scripted, trace, ….
    device
        What renders the force, in a word; None without a device.
    hand
        The hand that a page may take; None if the positions come from elsewhere.
    scene
        The slave's scene, if it is known and may be none of the built-in ones.
    operator_url
        Address of the operator view.
    in_words
        Returns an event in words.
    say
        Called with a line for the person at the terminal.
    """

    source: str
    device: str | None = None
    hand: LiveHand | None = None
    scene: SceneSettings | None = None
    operator_url: str | None = None
    in_words: Callable[[NodeEvent], str]
    say: Callable[[str], None]


class Page(Watcher[NodeEvent]):
    """A watcher of a master that keeps pages up to date and does what they ask.

    A tick appends a row to a list. Everything else is done 60 times a second, right after a tick, so that it is over
    before the next one; no page is waited for.

    Attributes
    ----------
    clients
        The pages that are connected.
    """

    name = "page"

    def __init__(self, node: MasterNode, controls: Controls, settings: PageSettings) -> None:
        self.clients: list[Client] = []
        self._node = node
        self._controls = controls
        self._settings = settings
        self._start_us = now_us()
        self._ticks = Ticks(node, self._start_us)
        self._traffic = TrafficMeter(node)
        self._round_trip = RecentMedian()
        self._seat = Seat(settings.hand)
        self._description = Description(node, controls, settings)
        self._events: deque[str] = deque(maxlen=messages.EVENTS_KEPT)
        self._frames = 0
        self._connections = 0
        self._streamed_us = 0  # when there was a session last
        self._is_ready = False
        self._told: dict[Client, tuple[str, HandState]] = {}
        self._left_out = 0  # for pages that have gone
        self._is_due = False
        self._failure: Exception | None = None
        self._timer: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Begin to send."""
        self._loop = asyncio.get_running_loop()
        self._timer = self._loop.call_later(INTERVAL_S, self._ring)

    def observe(self, now_us: int) -> None:
        """Take down a tick, and send when it is time."""
        if self._failure is not None:
            raise self._failure  # as from any watcher: it is told and switched off, and the run goes on
        self._ticks.add(now_us)
        if self._is_due:
            self._is_due = False
            self._loop.call_soon(self._fire)

    def note(self, event: NodeEvent, now_us: int) -> None:
        """Tell the watch views about an event, and follow the slave's scene."""
        if isinstance(event, Connected):
            self._connections += 1
            self._flush()  # what was before belongs to the scene before
            if self._description.follow_scene(event.grant.scene, is_new=not event.grant.resumed):
                for client in self.clients:
                    client.post(self._description.scene(client.view))
        text = messages.text("event", t_s=self._seconds(now_us), text=self._settings.in_words(event))
        self._events.append(text)
        self._tell_watchers(text)

    async def stop(self) -> None:
        """Disconnect every page."""
        if self._timer is not None:
            self._timer.cancel()
        for client in self.clients:
            client.close(CloseCode.MASTER_ENDED, "the master has ended")
        await asyncio.gather(*(client.finish() for client in self.clients))

    @property
    def is_full(self) -> bool:
        """Whether no more pages are served."""
        return len(self.clients) >= MOST_PAGES

    def connect(self, client: "Client") -> None:
        """Greet a page."""
        self._flush()  # so that the past it gets ends where its first message begins
        self.clients.append(client)
        client.post(self._description.hello(client.view))
        client.post(self._description.scene(client.view))
        client.post(messages.text("ready", ready=self._is_ready))
        self._tell_hand(client)
        if client.view == "watch":
            for event in self._events:
                client.post(event)
            client.post(self._state())
            for block in self._ticks.history():
                client.post_replaceable(block)

    def disconnect(self, client: "Client") -> None:
        """Forget a page; if it had the hand, the needle is withdrawn."""
        self.clients.remove(client)
        self._left_out += client.left_out
        self._told.pop(client, None)
        self._seat.release(client)

    def receive(self, client: "Client", data: str | bytes) -> None:
        """Do what a page asks; what it may not ask, and what makes no sense, is answered with an error."""
        try:
            message = messages.parse_text(data) if isinstance(data, str) else messages.parse_binary(data)
            self._obey(client, message)
        except PeerError as error:
            client.post_replaceable(messages.text("error", message=str(error)))
            if isinstance(error, MistakeError):
                self._count_mistake(client, str(error))

    def report(self) -> dict[str, Any]:
        """Return how many pages are connected, and how many messages were left out for slow ones."""
        views = [client.view for client in self.clients]
        left_out = self._left_out + sum(client.left_out for client in self.clients)
        return {**{view: views.count(view) for view in messages.VIEWS}, "left_out": left_out}

    def _obey(self, client: "Client", message: messages.PageMessage) -> None:
        if isinstance(message, Hand):
            self._seat.move(client, message)
        elif isinstance(message, Take):
            self._seat.take(client)
        elif isinstance(message, Release):
            self._seat.release(client)
        elif client.view != "watch":
            raise MistakeError("the operator view cannot do that")
        elif isinstance(message, LetGo):
            self._seat.let_go()
        else:
            self._controls.apply(message)
            self._traffic.restart(self._seconds(now_us()))
            self._tell_watchers(self._state())

    def _count_mistake(self, client: "Client", text: str) -> None:
        client.mistakes += 1
        if client.mistakes == 1:
            self._settings.say(f"a page sent a message that makes no sense and was ignored: {text}")
        elif client.mistakes >= messages.MOST_MISTAKES:
            client.close(CloseCode.TOO_MANY_MISTAKES, "too many messages that make no sense")

    def _ring(self) -> None:
        self._timer = self._loop.call_later(INTERVAL_S, self._ring)
        was_due, self._is_due = self._is_due, True
        if was_due:  # there was no tick since the last time
            self._fire()

    def _fire(self) -> None:
        try:
            self._send()
        except Exception as error:
            self._failure = error
            self._seat.let_go()
            if self._timer is not None:
                self._timer.cancel()

    def _send(self) -> None:
        self._seat.check()
        self._controls.work(now_us())
        self._follow_readiness()
        self._flush()
        self._frames += 1
        if self._frames % FRAMES_PER_STATE == 0:
            self._tell_watchers(self._state(), is_replaceable=True)
        for client in self.clients:
            self._tell_hand(client)
            client.post_replaceable(self._frame(client))

    def _flush(self) -> None:
        """Send the ticks since the last call to the watch views."""
        for block in self._ticks.take(self._description.mirror):
            self._tell_watchers(block, is_replaceable=True)

    def _follow_readiness(self) -> None:
        now = now_us()
        if self._node.session.streaming:
            self._streamed_us = now
            is_ready = True
        else:
            is_ready = self._is_ready and now - self._streamed_us < NOT_READY_AFTER_US
        if is_ready != self._is_ready:
            self._is_ready = is_ready
            for client in self.clients:
                client.post(messages.text("ready", ready=is_ready))

    def _tell_hand(self, client: "Client") -> None:
        """Tell a page who has the hand, if that has changed."""
        holder = self._seat.holder
        who = "nobody" if holder is None else "you" if holder is client else "another"
        told = who, self._seat.state
        if self._told.get(client) != told:
            self._told[client] = told
            client.post(messages.text("hand", holder=who, state=self._seat.state.name.lower()))

    def _tell_watchers(self, message: str | bytes, *, is_replaceable: bool = False) -> None:
        for client in self.clients:
            if client.view == "watch":
                if is_replaceable or isinstance(message, bytes):
                    client.post_replaceable(message)
                else:
                    client.post(message)

    def _frame(self, client: "Client") -> bytes:
        mirror, position_m = self._description.mirror, self._node.position_m
        tip_m = self._description.range_m[0] if position_m is None else position_m[0]
        time_ms = 0.0 if client.heard is None else client.heard.time_ms
        surfaces_m, contacts = ((), ()) if mirror is None else (mirror.surfaces_m, mirror.contacts)
        return messages.frame(self._seat.state, self._frames, time_ms, tip_m, surfaces_m, contacts)

    def _state(self) -> str:
        now_s = self._seconds(now_us())
        session = self._node.session
        round_trip_us = self._round_trip.of(session.round_trip, now_s)
        return messages.text(
            "state",
            t_s=now_s,
            since_s=self._traffic.since_s,
            link=session.state.value,
            connections=self._connections,
            sealed=session.sealed,
            **self._controls.report(),
            round_trip_ms=None if round_trip_us is None else round(round_trip_us / 1000, 3),
            **self._traffic.report(now_s),
            lost=self._traffic.lost,
            device=self._node.device_status,
            pages=self.report(),
        )

    def _seconds(self, at_us: int) -> float:
        return round(1e-6 * (at_us - self._start_us), 3)
