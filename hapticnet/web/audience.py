"""The connected pages and the hand that one of them may hold: the base of every kind of page."""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final

from hapticnet.checks import axes_of
from hapticnet.errors import PeerError
from hapticnet.node.events import NodeEvent
from hapticnet.operator.live import HandState, LiveHand
from hapticnet.runtime.watching import Watcher
from hapticnet.samples import Vector
from hapticnet.web import messages
from hapticnet.web.client import Client
from hapticnet.web.messages import CloseCode, Hand, MistakeError, Order, Reader, View
from hapticnet.web.mirror import Mirror

MOST_PAGES: Final = 16
INTERVAL_S: Final = 1 / messages.MESSAGES_PER_S


class Seat:
    """The hand (None if the positions come from elsewhere) and the page that holds it."""

    def __init__(self, hand: LiveHand | None) -> None:
        self.holder: Client | None = None  # the page that holds it, or None
        self._hand = hand

    @property
    def state(self) -> HandState:
        """The state of the hand."""
        return HandState.FREE if self._hand is None else self._hand.state

    def take(self, client: Client) -> None:
        """Give the hand to a page; raise PeerError if another one holds it or there is none."""
        if self._hand is None:
            raise PeerError("the positions of this run come from elsewhere; there is no hand to take")
        if self.holder is not None and self.holder is not client:
            raise PeerError("another page moves the needle")
        self.holder = client
        self._hand.take()

    def move(self, client: Client, hand: Hand) -> None:
        """Move the hand, if this page holds it. Otherwise it has just lost it, which is not a mistake."""
        if self._hand is not None and len(hand.position_m) != self._hand.axes:
            raise MistakeError(f"the hand has {axes_of(len(hand.position_m))}; in this run it has {self._hand.axes}")
        client.heard = hand
        if self._hand is not None and client is self.holder:
            self._hand.move(hand.position_m)

    def release(self, client: Client) -> None:
        """Take the hand back from a page, if it holds it."""
        if client is self.holder:
            self.let_go()

    def let_go(self) -> None:
        """Withdraw the needle and free the hand from any page."""
        self.holder = None
        if self._hand is not None and self._hand.state is not HandState.FREE:
            self._hand.release()

    def check(self) -> None:
        """Take the hand back from a page that was silent for too long."""
        if self.holder is not None and self.state in (HandState.WITHDRAWING, HandState.FREE):
            self.holder = None


def hello(view: View, source: str, hand: LiveHand | None) -> dict[str, Any]:
    """Return the content of the first message to any page; `source` names the source of positions in a word."""
    settings = None if hand is None else hand.settings
    about = {
        "source": source,
        "speed_m_per_s": None if settings is None else settings.speed_m_per_s,
        "delay_ms": None if settings is None else settings.delay_us / 1000,
        "repeat_ms": messages.REPEAT_MS,
    }
    return {"version": messages.VERSION, "view": view, "messages_per_s": messages.MESSAGES_PER_S, "hand": about}


class Audience(Watcher[NodeEvent], ABC):
    """A watcher that updates pages and handles their requests, without waiting for any of them.

    Everything except `_take_down` is done 60 times a second, right after a tick, to finish before the next one.
    """

    name = "page"
    views: tuple[View, ...] = messages.VIEWS  # the served views
    documents: ClassVar[Mapping[View, str]] = {view: f"{view}.html" for view in messages.VIEWS}  # the file of each view
    farewell = "the master has ended"  # the last message to pages
    packages: tuple[str, ...] = (
        "hapticnet.web",
    )  # those whose folders static/ have its files; the last has precedence
    further: ClassVar[Mapping[str, Reader]] = {}  # readers of the messages of this page alone, by type

    def __init__(self, hand: LiveHand | None, say: Callable[[str], None]) -> None:
        self.clients: list[Client] = []  # the connected pages
        self.seat = Seat(hand)  # who holds the hand
        self._say = say
        self._frames = 0
        self._told: dict[Client, tuple[str, HandState]] = {}
        self._is_due = False
        self._has_told_mistake = False
        self._failure: Exception | None = None
        self._timer: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Begin to send."""
        self._loop = asyncio.get_running_loop()
        self._timer = self._loop.call_later(INTERVAL_S, self._ring)

    def observe(self, now_us: int) -> None:
        """Record a tick, and send when it is time."""
        if self._failure is not None:
            raise self._failure  # as with any watcher: it is reported and switched off, and the run continues
        self._take_down(now_us)
        if self._is_due:
            self._is_due = False
            self._loop.call_soon(self._fire)

    async def stop(self) -> None:
        """Disconnect every page."""
        if self._timer is not None:
            self._timer.cancel()
        for client in self.clients:
            client.close(*self.parting)
        await asyncio.gather(*(client.finish() for client in self.clients))

    @property
    def parting(self) -> tuple[int, str]:
        """Code and reason with which pages are disconnected at the end."""
        return CloseCode.MASTER_ENDED, self.farewell

    def refusal(self) -> tuple[CloseCode, str] | None:
        """Return why another page is refused; None if it is accepted."""
        return (CloseCode.TOO_MANY_PAGES, "too many pages are open") if len(self.clients) >= MOST_PAGES else None

    def connect(self, client: Client) -> None:
        """Greet a page."""
        self.clients.append(client)
        self._greet(client)

    def disconnect(self, client: Client) -> None:
        """Forget a page; if it held the hand, withdraw the needle."""
        self.clients.remove(client)
        self._told.pop(client, None)
        self.seat.release(client)

    def receive(self, client: Client, data: str | bytes) -> None:
        """Handle a page's request; answer forbidden or invalid ones with an error."""
        try:
            message = messages.parse_text(data, self.further) if isinstance(data, str) else messages.parse_binary(data)
            if isinstance(message, Hand):
                self.seat.move(client, message)
            elif message is Order.TAKE:
                self._give_hand(client)
            elif message is Order.RELEASE:
                self.seat.release(client)
            else:
                self._obey(client, message)
        except PeerError as error:
            client.post_replaceable(messages.text("error", message=str(error)))
            if isinstance(error, MistakeError):
                self._count_mistake(client, str(error))

    @abstractmethod
    def _greet(self, client: Client) -> None:
        """Send the first messages to a page."""

    @abstractmethod
    def _obey(self, client: Client, message: object) -> None:
        """Handle a page's request, except about the hand; raise PeerError if it is forbidden."""

    @abstractmethod
    def _send(self) -> None:
        """Send due messages, `messages.MESSAGES_PER_S` times a second."""

    def _give_hand(self, client: Client) -> None:
        self.seat.take(client)

    def _take_down(self, now_us: int) -> None:
        """Record a tick, during it."""

    def _tell_all(self, message: str) -> None:
        for client in self.clients:
            client.post(message)

    def _tell_hand(self, client: Client) -> None:
        holder = self.seat.holder
        who = "nobody" if holder is None else "you" if holder is client else "another"
        told = who, self.seat.state
        if self._told.get(client) != told:
            self._told[client] = told
            client.post(messages.text("hand", holder=who, state=self.seat.state.name.lower()))

    def _send_frames(self, tip_m: Vector, mirror: Mirror | None, force_n: Vector = ()) -> None:
        surfaces_m, contacts = ((), ()) if mirror is None else (mirror.scene.surfaces_m(), mirror.scene.contacts())
        further = tip_m[1:]
        for client in self.clients:
            self._tell_hand(client)
            time_ms = 0.0 if client.heard is None else client.heard.time_ms
            seen = (*further, *force_n) if further and client.view == "watch" else further
            client.post_replaceable(
                messages.frame(self.seat.state, self._frames, time_ms, tip_m[0], surfaces_m, contacts, seen)
            )

    def _count_mistake(self, client: Client, text: str) -> None:
        client.mistakes += 1
        if not self._has_told_mistake:  # a page that connects again and again must not fill the log
            self._has_told_mistake = True
            self._say(f"a page sent a message that makes no sense and was ignored: {text}")
        elif client.mistakes >= messages.MOST_MISTAKES:
            client.close(CloseCode.TOO_MANY_MISTAKES, "too many messages that make no sense")

    def _ring(self) -> None:
        self._timer = self._loop.call_later(INTERVAL_S, self._ring)
        was_due, self._is_due = self._is_due, True
        if was_due:  # no tick since the last time
            self._fire()

    def _fire(self) -> None:
        try:
            self.seat.check()
            self._frames += 1
            self._send()
        except Exception as error:
            self._failure = error
            self.seat.let_go()
            if self._timer is not None:
                self._timer.cancel()
