"""The live page beside a master: records each tick, and updates every connected page."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from hapticnet import __version__
from hapticnet.control.swing import SwingWatch
from hapticnet.node.events import NodeEvent, SettingsInForce
from hapticnet.node.master import MasterNode
from hapticnet.operator.live import LiveHand
from hapticnet.protocol.states import Connected
from hapticnet.runtime.system import now_us
from hapticnet.scene.shapes import Shape
from hapticnet.web import messages
from hapticnet.web.audience import Audience, hello
from hapticnet.web.controls import Controls
from hapticnet.web.messages import Change, MistakeError, Order, View
from hapticnet.web.mirror import Mirror, scene_called
from hapticnet.web.ticks import Ticks
from hapticnet.web.traffic import RecentMedian, TrafficMeter

if TYPE_CHECKING:
    from hapticnet.web.client import Client

NOT_READY_AFTER_US: Final = 1_000_000  # wait before pages learn of a lost session; a change of codec is faster
ASK_EVERY_US: Final = 1_000_000  # how often [µs] to ask how the scene looks, while there is a page
WARN_EVERY_US: Final = 10_000_000
MOST_SAMPLES: Final = 2_800  # of vibration, that wait for the next message: those of a second
SWINGS: Final = (
    "the hand begins to swing: start the master with --coupling energy-bounded, or shorten the delay, because the force"
    " comes late and pushes the hand on"
)
FRAMES_PER_STATE: Final = messages.MESSAGES_PER_S // messages.STATES_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class PageSettings:
    """The subject of a page."""

    source: str  # source of the positions, in a word: page, scripted, trace, ….
    device: str | None = None  # device that renders the force, in a word; None without one
    hand: LiveHand | None = None  # the hand that a page may take; None if the positions come from elsewhere
    yields: bool = False  # whether the force can move the hand
    operator_url: str | None = None  # address of the operator view
    in_words: Callable[[NodeEvent], str]  # returns an event in words
    say: Callable[[str], None]  # called with a line for the person at the terminal


class Page(Audience):
    """The page of a master: a tick appends a row to a list, and everything else is done outside it."""

    def __init__(self, node: MasterNode, controls: Controls, settings: PageSettings) -> None:
        super().__init__(settings.hand, settings.say)
        self._node = node
        self._controls = controls
        self._settings = settings
        self._start_us = now_us()
        self._ticks = Ticks(node, self._start_us)
        self._traffic = TrafficMeter(node)
        self._round_trip = RecentMedian()
        watches = settings.yields or node.settings.coupling != "direct"
        self._port = SwingWatch() if watches else None
        self._warned_us = -WARN_EVERY_US
        self._mirror: Mirror | None = None  # the copy of the slave's scene; None while it is not known
        self._asked_us = -ASK_EVERY_US
        self._drawn: dict[int, Shape] = {}  # the shapes that pages have
        self._events: deque[str] = deque(maxlen=messages.EVENTS_KEPT)
        self._vibration: list[float] = []  # played since the last message
        self._connections = 0
        self._streamed_us = 0  # time of the last session
        self._is_ready = False
        self._left_out = 0  # for pages that have gone

    def note(self, event: NodeEvent, now_us: int) -> None:
        """Report an event to the watch views, and follow the slave's scene."""
        if isinstance(event, SettingsInForce):  # the state message has them
            return
        if isinstance(event, Connected):
            self._connections += 1
            self._asked_us = -ASK_EVERY_US  # the new session has not been asked yet
            self._flush()  # earlier rows belong to the previous scene
            if self._follow_scene(event.grant.scene, is_new=not event.grant.resumed):
                for client in self.clients:
                    client.post(self._scene(client.view))
        self._report(self._settings.in_words(event), now_us)

    def connect(self, client: "Client") -> None:
        """Greet a page."""
        self._flush()  # so that its first message begins with the next tick
        super().connect(client)

    def disconnect(self, client: "Client") -> None:
        """Forget a page; if it held the hand, withdraw the needle."""
        super().disconnect(client)
        self._left_out += client.left_out

    def report(self) -> dict[str, Any]:
        """Return how many pages are connected, and how many messages were omitted for slow ones."""
        views = [client.view for client in self.clients]
        left_out = self._left_out + sum(client.left_out for client in self.clients)
        return {**{view: views.count(view) for view in messages.VIEWS}, "left_out": left_out}

    def _greet(self, client: "Client") -> None:
        client.post(self._hello(client.view))
        client.post(self._scene(client.view))
        if self._node.shapes:
            client.post(self._shapes({}))
        client.post(messages.text("ready", ready=self._is_ready))
        self._tell_hand(client)
        if client.view == "watch":
            for event in self._events:
                client.post(event)
            client.post(self._state())

    def _obey(self, client: "Client", message: object) -> None:
        if client.view != "watch":
            raise MistakeError("the operator view cannot do that")
        if message is Order.LET_GO:
            self.seat.let_go()
        elif isinstance(message, Change):
            self._controls.apply(message)
            self._traffic.restart(self._seconds(now_us()))
            self._port = SwingWatch() if self._port is not None else None
            self._tell_watchers(self._state())

    def _report(self, words: str, now_us: int) -> None:
        text = messages.text("event", t_s=self._seconds(now_us), text=words)
        self._events.append(text)
        self._tell_watchers(text)

    def _take_down(self, now_us: int) -> None:
        self._ticks.add(now_us)
        node = self._node
        if node.vibration is not None and len(self._vibration) < MOST_SAMPLES:
            self._vibration += node.vibration.played_m_s2
        if self._port is not None and node.position_m is not None:
            axes = node.first_axes
            self._port.add(now_us, node.held_n[:axes], node.position_m[:axes], node.codec.law)

    def _port_state(self, now_us: int) -> dict[str, Any] | None:
        """Return the energy at the port; warn if the hand begins to swing."""
        port = self._port
        if port is None:
            return None
        swings = port.swings(now_us)
        # A coupling says itself when it holds the force back.
        if swings and now_us - self._warned_us > WARN_EVERY_US and self._node.settings.coupling == "direct":
            self._warned_us = now_us
            self._settings.say(SWINGS)
            self._report(SWINGS, now_us)
        energy = {key: round(getattr(port, key), 6) for key in ("put_in_j", "given_back_j", "created_j")}
        return {**energy, "swings": swings}

    def _send(self) -> None:
        self._controls.work(now_us())
        self._follow_readiness()
        self._flush()
        if self._frames % FRAMES_PER_STATE == 0:
            self._tell_watchers(self._state(), is_replaceable=True)
        if self.clients and self._mirror is None and not 0 <= now_us() - self._asked_us < ASK_EVERY_US:
            self._asked_us = now_us()
            self._node.session.ask_for_shapes()
        if self._drawn != self._node.shapes:
            self._tell_all(self._shapes(self._drawn))
            self._drawn = self._node.shapes
        axes = self._node.first_axes
        rest_m = (self._range_m[0], *(0.0,) * (axes - 1))
        self._send_frames((self._node.position_m or rest_m)[:axes], self._mirror, self._node.held_n[:axes])

    def _flush(self) -> None:
        """Send the ticks since the last call to the watch views."""
        for block in self._ticks.take(self._mirror):
            self._tell_watchers(block, is_replaceable=True)
        if self._vibration:
            self._tell_watchers(messages.vibration(self._vibration), is_replaceable=True)
            self._vibration.clear()

    def _follow_readiness(self) -> None:
        now = now_us()
        if self._node.session.streaming:
            self._streamed_us = now
            is_ready = True
        else:
            is_ready = self._is_ready and now - self._streamed_us < NOT_READY_AFTER_US
        if is_ready != self._is_ready:
            self._is_ready = is_ready
            self._tell_all(messages.text("ready", ready=is_ready))

    def _tell_watchers(self, message: str | bytes, *, is_replaceable: bool = False) -> None:
        for client in self.clients:
            if client.view == "watch":
                if is_replaceable or isinstance(message, bytes):
                    client.post_replaceable(message)
                else:
                    client.post(message)

    def _state(self) -> str:
        now_s = self._seconds(now_us())
        session = self._node.session
        felt = self._ticks.felt(self._node.codec.law)
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
            **self._traffic.report(now_s, felt=self._ticks.take_felt()),
            arrived=self._traffic.arrived,
            lost=self._traffic.lost,
            felt=None if felt is None else asdict(felt),
            port=self._port_state(now_us()),
            device=self._node.device_status,
            pages=self.report(),
        )

    @property
    def _range_m(self) -> tuple[float, float]:
        """Range of positions [m] shown, in which a hand may move the needle."""
        if self._mirror is not None:
            return self._mirror.range_m
        hand = self._settings.hand
        return hand.range_m if hand is not None else (0.0, 0.1)

    def _follow_scene(self, name: str, *, is_new: bool) -> bool:
        """Use the scene that the slave calls `name`; return whether it changed."""
        before = self._mirror.settings if self._mirror is not None else None
        known = scene_called(name) if self._node.axes == 1 else None
        if known is None:
            self._mirror = None
        elif is_new or known != before:
            self._mirror = Mirror(known, is_new=is_new)
        if self._mirror is not None and self._settings.hand is not None:
            self._settings.hand.set_range(*self._mirror.range_m)
        return known != before or known is None

    def _hello(self, view: View) -> str:
        settings = self._settings
        content = hello(view, settings.source, settings.hand)
        if view == "watch":
            content |= {
                "rate_hz": 1e6 / self._node.position_period_us,
                "axes": self._node.first_axes,
                "device": settings.device,
                "largest_n": self._node.largest_n,
                "master": self._node.settings.name,
                "hapticnet": __version__,
                "columns": messages.COLUMNS,
                "history_s": messages.HISTORY_S,
                "codecs": self._controls.codecs(),
                "limits": messages.LIMITS,
                "adjustable": self._controls.adjustable,
                "operator_url": settings.operator_url,
            }
        return messages.text("hello", **content)

    def _scene(self, view: View) -> str:
        tissues = self._mirror.settings.tissues if self._mirror is not None else ()
        shown: list[dict[str, Any]] = [{"rest_m": tissue.rest_position_m} for tissue in tissues]
        content: dict[str, Any] = {"known": self._mirror is not None, "range_m": self._range_m, "tissues": shown}
        content |= {"axes": self._node.first_axes, "reach_m": (self._settings.hand or LiveHand()).settings.reach_m}
        if view == "watch":  # the operator view cannot show what it does not get
            content |= {"name": self._node.scene_name, "parts": [each.label for each in self._node.parts]}
            for about, tissue in zip(shown, tissues, strict=True):
                about |= {key: getattr(tissue, key) for key in ("name", "stiffness_n_per_m", "breach_force_n")}
        return messages.text("scene", **content)

    def _shapes(self, known: Mapping[int, Shape]) -> str:
        """Return how the scene looks, for pages that know some of it."""
        now = self._node.shapes
        return messages.text(
            "shapes", count=len(now), changed={place: each for place, each in now.items() if known.get(place) != each}
        )

    def _seconds(self, at_us: int) -> float:
        return round(1e-6 * (at_us - self._start_us), 3)
