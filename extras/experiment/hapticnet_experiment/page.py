"""The participant's page: the operator view of the live page, with the screens of a session.

The participant answers with keys or clicks; the experimenter is at the terminal. The page cannot show what it does not
get: the scene message has no stiffness, and no message has a force, a codec, a condition or a count of packets.

Messages are those of the operator view (`hapticnet.web.messages`), for one page at a time. Its hello has
``"experiment": {"masking_noise": false, "texts": {"connected": "…", …}}``, tissues are named by their number from front
to back, and frames come only while a scene can be touched. ``task`` says what to show and which keys do something
(`screens`)::

    {"type": "task", "number": 7, "screen": "trial", "title": "Feel the three tissues", "text": "…",
     "keys": [{"key": "1", "does": "tissue 1"}, {"key": "escape", "does": "stop: …"}],
     "typed": "21", "remark": "", "progress": "3 of 40 trials",                    // of an answer; on the last key
     "wait_s": 0.0}                                                                // until "enter" does something

No task names a condition or a force, or, outside of practice, the right answer. From the page come::

    {"type": "key", "number": 7, "key": "enter"}  // press a key of the task with this number; ignored if that task is
                                                  // over, so that no press answers another question
    {"type": "noise", "level": 0.3}               // level of the masking noise, as a share of full scale
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

from aiohttp import WSCloseCode

from hapticnet.errors import PeerError
from hapticnet.node.events import NodeEvent
from hapticnet.operator.base import Operator
from hapticnet.operator.live import LiveHand
from hapticnet.protocol.states import Connected
from hapticnet.runtime.system import now_us
from hapticnet.samples import PositionSample
from hapticnet.scene.settings import SceneSettings
from hapticnet.web import messages
from hapticnet.web.audience import Audience, hello
from hapticnet.web.client import Client
from hapticnet.web.messages import CloseCode, MistakeError, Reader, View
from hapticnet.web.mirror import Mirror
from hapticnet_experiment import screens
from hapticnet_experiment.flow import Flow
from hapticnet_experiment.fronts import KeyFront, Stop
from hapticnet_experiment.rig import Activity, Outcome, Rig
from hapticnet_experiment.rows import AnyRow
from hapticnet_experiment.screens import Screen, ScreenKind, Texts
from hapticnet_experiment.trial import Stimulus

if TYPE_CHECKING:
    import asyncio

OTHER_PAGE: Final = "the session is open on another page; close that one first"
CLOSED: Final = Stop("the page was closed")
STOPPED: Final = Stop("the experimenter stopped")


class Key(NamedTuple):
    """Press a key of the task with this number."""

    number: int
    key: str


class Noise(NamedTuple):
    """The level of the masking noise, as a share of full scale; 0 if it is off."""

    level: float


def read_key(content: Mapping[str, Any]) -> Key:
    """Return the message ``key`` with this content; raise MistakeError if it is invalid."""
    number, key = content.get("number"), content.get("key")
    if len(content) != 2 or type(number) is not int or not isinstance(key, str):
        raise MistakeError("message 'key' takes the number of a task and a key, and nothing else")
    return Key(number, key)


def read_noise(content: Mapping[str, Any]) -> Noise:
    """Return the message ``noise`` with this content; raise MistakeError if it is invalid."""
    level = content.get("level")
    if len(content) != 1 or isinstance(level, bool) or not isinstance(level, (int, float)) or not 0.0 <= level <= 1.0:
        raise MistakeError("message 'noise' takes a level between 0 and 1, and nothing else")
    return Noise(float(level))


class SeenHand:
    """An operator that records its positions for the page."""

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


class ParticipantPage(KeyFront, Audience):
    """Shows a participant the screens of a session, and the scene during a trial.

    `hand` is None if nothing moves; `source` names the source of its positions in a word. `say` is called
    with lines for the experimenter: what the participant sees, never the condition.
    """

    views: tuple[View, ...] = ("operator",)
    farewell = "the session has ended"
    packages = (*Audience.packages, "hapticnet_experiment")
    further: ClassVar[Mapping[str, Reader]] = {"key": read_key, "noise": read_noise}

    def __init__(
        self, hand: SeenHand | None, source: str, *, texts: Texts, masking_noise: bool, say: Callable[[str], None]
    ) -> None:
        operator = None if hand is None else hand.operator
        self._live = operator if isinstance(operator, LiveHand) else None
        KeyFront.__init__(self)
        Audience.__init__(self, self._live, say)
        self._hand = hand
        self._source = source
        self._texts = texts
        self._masking_noise = masking_noise
        self._flow: Flow[Any] | None = None
        self._activity: Activity | None = None
        self._level = 0.0
        self._printed = 0  # number of the last question shown
        self._scene: SceneSettings | None = None
        self._mirror: Mirror | None = None
        self._is_ready = False
        self._tip_m = 0.0

    @property
    def parting(self) -> tuple[int, str]:
        """A session that is not over may continue, and the page with it."""
        over = self._shown is not None and self._shown.kind is ScreenKind.DONE
        return super().parting if over else (WSCloseCode.GOING_AWAY, "the session is interrupted")

    async def attend(self, flow: Flow[AnyRow], activity: "asyncio.Future[Outcome]", rig: Rig) -> Outcome:
        """Pass on keys during an activity; stop it when there is an answer, or no page."""
        if not self.clients:
            self.hear(CLOSED)
        return await super().attend(flow, activity, rig)

    def hear_experimenter(self, key: str) -> None:
        """Process a key of the experimenter: Escape stops the activity."""
        if key == screens.ESCAPE:
            self.hear(STOPPED)

    def _present(self, flow: Flow[AnyRow]) -> None:
        self._flow = flow
        if flow.activity is not self._activity:
            self._activity = flow.activity
            trial = flow.activity if isinstance(flow.activity, Stimulus) else None
            self._scene = None if trial is None else SceneSettings(name="study", tissues=trial.tissues)
            self._restart()  # the needle can be moved once there is a session
            if self._scene is not None:
                self._tell_all(self._scene_text())
        super()._present(flow)

    def _print(self, flow: Flow[AnyRow]) -> None:
        self._tell_all(self._task())
        if self.number != self._printed and flow.screen.kind is not ScreenKind.MOMENT:
            self._say(_line(flow))
        self._printed = self.number

    def note(self, event: NodeEvent, now_us: int) -> None:
        """Let the participant begin once there is a session with the slave."""
        del now_us
        if isinstance(event, Connected) and self._scene is not None:
            self._restart()
            self._tell_ready(True)

    def refusal(self) -> tuple[CloseCode, str] | None:
        """Return why another page is refused: only one can answer."""
        return (CloseCode.ANOTHER_PAGE, OTHER_PAGE) if self.clients else None

    def connect(self, client: Client) -> None:
        """Greet the page."""
        super().connect(client)
        self._say("the participant's page is open")

    def disconnect(self, client: Client) -> None:
        """Withdraw the needle, and end the activity."""
        super().disconnect(client)
        self._say("the participant's page is closed")
        self._note_noise(0.0)
        self.hear(CLOSED)

    def _greet(self, client: Client) -> None:
        experiment = {"masking_noise": self._masking_noise, "texts": self._texts.for_page()}
        client.post(messages.text("hello", **hello("operator", self._source, self._live), experiment=experiment))
        client.post(self._scene_text())
        client.post(messages.text("ready", ready=self._is_ready))
        self._tell_hand(client)
        client.post(self._task())

    def _obey(self, client: Client, message: object) -> None:
        del client
        if isinstance(message, Key):
            self.hear(message.key, message.number)
        elif isinstance(message, Noise):
            self._note_noise(message.level)
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
        self._send_frames((self._tip_m,), self._mirror)

    def _restart(self) -> None:
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
        screen = Screen(kind=ScreenKind.MOMENT, title="", text="") if self._shown is None else self._shown
        wait_us = 0 if screen.not_before_us is None else max(0, screen.not_before_us - now_us())
        return messages.text(
            "task",
            number=self.number,
            screen="wait" if self._shown is None else screen.kind.value,
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

    def _note_noise(self, level: float) -> None:
        if self._flow is not None and level != self._level:
            self._level = level
            self._flow.note_noise(level, now_us())
            self.hear("")  # so that the row is stored now


def _line(flow: Flow[Any]) -> str:
    """Return the participant's screen as a line, with the reason after a failed trial."""
    screen = flow.screen
    line = f"{screen.title} ({screen.progress})" if screen.progress else screen.title
    if screen.kind is ScreenKind.REPEAT:
        reason = next((row.reason for row in reversed(flow.rows) if row.reason is not None), None)
        line = line if reason is None else f"{line}: {reason}"
    return line
