"""A participant at a page in the browser, who answers with keys or clicks; the experimenter is at the terminal."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from hapticnet.runtime.system import now_us
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.key_front import KeyFront, Stop
from hapticnet.study.page import ParticipantPage
from hapticnet.study.rig import Activity, Outcome, Play, Rig
from hapticnet.study.rows import AnyRow
from hapticnet.study.screens import ScreenKind

if TYPE_CHECKING:
    import asyncio

CLOSED: Final = Stop("the page was closed")
STOPPED: Final = Stop("the experimenter stopped")


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
