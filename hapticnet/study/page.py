"""The participant's page: the operator view of the live page, with the screens of a session.

The participant answers with keys or clicks; the experimenter is at the terminal.

What it is not told, it cannot show: the scene message has no stiffness, and no message has a force, a codec, a
condition or a count of packets. What a screen says is in `screens`.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from aiohttp import WSCloseCode

from hapticnet.errors import PeerError
from hapticnet.node.events import NodeEvent
from hapticnet.operator.base import Operator
from hapticnet.operator.live import LiveHand
from hapticnet.protocol.states import Connected
from hapticnet.runtime.system import now_us
from hapticnet.samples import PositionSample
from hapticnet.scene.settings import SceneSettings
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.fronts import KeyFront, Stop
from hapticnet.study.rig import Activity, Outcome, Play, Rig
from hapticnet.study.rows import AnyRow
from hapticnet.study.screens import Screen, ScreenKind
from hapticnet.study.texts import Texts
from hapticnet.study.trial import Stimulus
from hapticnet.web import messages
from hapticnet.web.audience import Audience, hello
from hapticnet.web.client import Client
from hapticnet.web.messages import CloseCode, Key, MistakeError, Noise, PageMessage, View
from hapticnet.web.mirror import Mirror

if TYPE_CHECKING:
    import asyncio

OTHER_PAGE: Final = "the session is open on another page; close that one first"
CLOSED: Final = Stop("the page was closed")
STOPPED: Final = Stop("the experimenter stopped")


class SeenHand:
    """An operator whose positions are kept for the page."""

    def __init__(self, operator: Operator) -> None:
        self.operator = operator
        self.axes = operator.axes
        self.duration_us = operator.duration_us
        self._taken: list[tuple[int, float]] = []
        feel = getattr(operator, "feel", None)
        if feel is not None:
            self.feel = feel

    def sample(self, t_us: int) -> PositionSample:
        """Return the operator's position at `t_us` [µs]."""
        sample = self.operator.sample(t_us)
        self._taken.append((t_us, sample.position_m[0]))
        return sample

    def take(self) -> list[tuple[int, float]]:
        """Return times [µs] and positions [m] since the last call."""
        taken, self._taken = self._taken, []
        return taken


class ParticipantPage(Audience):
    """Shows a participant the screens of a session, and the scene during a trial.

    Parameters
    ----------
    hand
        The hand; None if nothing is to be moved.
    source
        Where its positions come from, in a word: page, trace, udp, ….
    texts
        What the participant reads.
    masking_noise
        Whether masking noise begins with the first press on the page.
    say
        Called with a line for the experimenter.

    Attributes
    ----------
    number
        Number of the present question.
    on_key, on_noise, on_change
        Called with a key and the number of its task; with a level of the masking noise; when the page comes or goes.
    """

    views: tuple[View, ...] = ("operator",)
    farewell = "the session has ended"

    def __init__(
        self, hand: SeenHand | None, source: str, *, texts: Texts, masking_noise: bool, say: Callable[[str], None]
    ) -> None:
        operator = None if hand is None else hand.operator
        self._live = operator if isinstance(operator, LiveHand) else None
        super().__init__(self._live, say)
        self.number = 0
        self.on_key: Callable[[int, str], None] = lambda _number, _key: None
        self.on_noise: Callable[[float], None] = lambda _: None
        self.on_change: Callable[[bool], None] = lambda _: None
        self._hand = hand
        self._source = source
        self._texts = texts
        self._masking_noise = masking_noise
        self._screen: Screen | None = None
        self._scene: SceneSettings | None = None
        self._mirror: Mirror | None = None
        self._is_ready = False
        self._tip_m = 0.0

    @property
    def parting(self) -> tuple[int, str]:
        """A session that is not over may go on, and the page with it."""
        over = self._screen is not None and self._screen.kind is ScreenKind.DONE
        return super().parting if over else (WSCloseCode.GOING_AWAY, "the session is interrupted")

    @property
    def is_open(self) -> bool:
        """Whether a participant has the page open."""
        return bool(self.clients)

    def show(self, screen: Screen, number: int) -> None:
        """Show a screen that asks the question of this number."""
        self.number = number
        self._screen = screen
        self._tell_all(self._task())

    def begin(self, stimulus: Stimulus) -> None:
        """Show the tissues of a trial, with the needle in front of them; it can be moved once there is a session."""
        self._scene = SceneSettings(name="study", tissues=stimulus.tissues)
        self._restart()
        self._tell_all(self._scene_text())

    def end(self) -> None:
        """Show no scene any more."""
        self._scene = None
        self._restart()

    def note(self, event: NodeEvent, now_us: int) -> None:
        """Let the participant begin when there is a session with the slave."""
        del now_us
        if isinstance(event, Connected) and self._scene is not None:
            self._restart()
            self._tell_ready(True)

    def refusal(self) -> tuple[CloseCode, str] | None:
        """Return why one page more is not served: only one can answer."""
        return (CloseCode.ANOTHER_PAGE, OTHER_PAGE) if self.clients else None

    def connect(self, client: Client) -> None:
        """Greet the page."""
        super().connect(client)
        self.on_change(True)

    def disconnect(self, client: Client) -> None:
        """Withdraw the needle."""
        super().disconnect(client)
        self.on_change(False)

    def _greet(self, client: Client) -> None:
        experiment = {"masking_noise": self._masking_noise, "texts": self._texts.for_page()}
        client.post(messages.text("hello", **hello("operator", self._source, self._live), experiment=experiment))
        client.post(self._scene_text())
        client.post(messages.text("ready", ready=self._is_ready))
        self._tell_hand(client)
        client.post(self._task())

    def _obey(self, client: Client, message: PageMessage) -> None:
        del client
        if isinstance(message, Key):
            self.on_key(message.number, message.key)
        elif isinstance(message, Noise):
            self.on_noise(message.level)
        else:
            raise MistakeError("the participant's page cannot do that")

    def _give_hand(self, client: Client) -> None:
        if not self._is_ready:
            raise PeerError("there is nothing to touch yet")
        super()._give_hand(client)

    def _send(self) -> None:
        taken = [] if self._hand is None else self._hand.take()
        if self._mirror is None or not self._is_ready:
            return
        if taken:
            times_us, positions_m = zip(*taken, strict=True)
            self._mirror.forces_n(times_us, positions_m)
            self._tip_m = positions_m[-1]
        self._send_frames(self._tip_m, self._mirror)

    def _restart(self) -> None:
        """Put the needle and all tissues back."""
        self._tell_ready(False)
        self.seat.let_go()
        if self._hand is not None:
            self._hand.take()
        self._mirror = None if self._scene is None else Mirror(self._scene, is_new=True)
        self._tip_m = 0.0 if self._mirror is None else self._mirror.range_m[0]
        if self._live is not None:
            self._live.restart(*(self._live.range_m if self._mirror is None else self._mirror.range_m))
        for client in self.clients:
            self._tell_hand(client)

    def _tell_ready(self, ready: bool) -> None:
        if ready != self._is_ready:
            self._is_ready = ready
            self._tell_all(messages.text("ready", ready=ready))

    def _task(self) -> str:
        screen = Screen(kind=ScreenKind.MOMENT, title="", text="") if self._screen is None else self._screen
        wait_us = 0 if screen.not_before_us is None else max(0, screen.not_before_us - now_us())
        return messages.text(
            "task",
            number=self.number,
            screen="wait" if self._screen is None else screen.kind.value,
            title=screen.title,
            text=screen.text,
            keys=[{"key": key, "does": does} for key, does in screen.keys],
            typed=screen.typed,
            remark=screen.remark,
            progress=screen.progress,
            wait_s=wait_us / 1e6,
        )

    def _scene_text(self) -> str:
        mirror, scene = self._mirror, self._scene
        if mirror is None or scene is None:
            return messages.text("scene", known=False, range_m=(0.0, 0.1), tissues=[])
        tissues = [{"rest_m": tissue.rest_position_m, "name": tissue.name} for tissue in scene.tissues]
        return messages.text("scene", known=True, range_m=mirror.range_m, tissues=tissues)


class PageFront(KeyFront):
    """Shows the flow on a `ParticipantPage`.

    Parameters
    ----------
    tell
        Called with a line for the experimenter: what the participant sees, never the condition.
    """

    def __init__(self, page: ParticipantPage, tell: Callable[[str], None]) -> None:
        super().__init__()
        self._page = page
        self._tell = tell
        self._flow: Flow[Any] | None = None
        self._activity: Activity | None = None
        self._level = 0.0
        page.on_key = lambda number, key: self.hear(key, number)
        page.on_noise = self._note_noise
        page.on_change = self._note_change

    def hear_experimenter(self, key: str) -> None:
        """Take a key of the experimenter: Escape stops what is performed."""
        if key == screens.ESCAPE:
            self.hear(STOPPED)

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Pass keys on while an activity is performed; stop it when there is an answer, or nobody to give one."""
        if not self._page.is_open:
            self.hear(CLOSED)
        return await super().attend(flow, activity, rig)

    def _present(self, flow: Flow[AnyRow]) -> None:
        self._flow = flow
        if flow.activity is not self._activity:
            self._activity = flow.activity
            if isinstance(flow.activity, Play):
                self._page.begin(flow.activity.stimulus)
            else:
                self._page.end()
        super()._present(flow)

    def _print(self, flow: Flow[AnyRow]) -> None:
        is_new = self.number != self._page.number
        self._page.show(flow.screen, self.number)
        if is_new and flow.screen.kind is not ScreenKind.MOMENT:
            self._tell(_line(flow))

    def _note_noise(self, level: float) -> None:
        if self._flow is not None and level != self._level:
            self._level = level
            self._flow.note_noise(level, now_us())
            self.hear("")  # so that the row is stored now

    def _note_change(self, is_open: bool) -> None:
        self._tell(f"the participant's page is {'open' if is_open else 'closed'}")
        if not is_open:
            self._note_noise(0.0)
            self.hear(CLOSED)


def _line(flow: Flow[Any]) -> str:
    """Return what the participant sees in a line, and after a trial in vain why it was."""
    screen = flow.screen
    line = f"{screen.title} ({screen.progress})" if screen.progress else screen.title
    if screen.kind is ScreenKind.REPEAT:
        reason = next((row.reason for row in reversed(flow.rows) if row.reason is not None), None)
        line = line if reason is None else f"{line}: {reason}"
    return line
