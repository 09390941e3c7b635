"""What a slave tells the person who watches it."""

from typing import TYPE_CHECKING, Any, Final

from hapticnet.api.slave_setup import place
from hapticnet.node.events import MasterJoined, MasterLeft, MasterRefused, ScenePaused, SceneResumed, SlaveEvent
from hapticnet.node.slave import SlaveNode
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.protocol.keys import format_key
from hapticnet.protocol.messages import Code
from hapticnet.runtime.watching import Watcher

if TYPE_CHECKING:
    from hapticnet.cli.console import Console
    from hapticnet.node.slave_context import SlaveContext
    from hapticnet.runtime.trust import Guests


MOST_UNREAD: Final = 10  # reasons for which HELLOs were dropped that are told, each once: strangers choose them
MOST_FAILURES: Final = 10  # different failures of scenes and codecs that the report and the last line of the run name


class SlaveMessages(Watcher[SlaveEvent]):
    """Messages about masters that come and go, and the status line.

    `guests`: the masters with keys; None if there are no sealed sessions.
    """

    name = "messages"

    def __init__(self, console: "Console", node: SlaveNode, guests: "Guests | None") -> None:
        self._console = console
        self._node = node
        self._guests = guests
        self._said_unkeyed = False
        self._said_unread: set[str] = set()
        self._failures: set[str] = set()
        self._said_draining = False

    def note(self, event: SlaveEvent, now_us: int) -> None:  # noqa: ARG002 - messages have their own time
        """Tell what has happened."""
        failure = None
        if isinstance(event, MasterLeft):
            failure = event.context.failure
        elif isinstance(event, MasterRefused) and event.code is Code.FAILED:
            failure = event.reason
        if failure is not None and failure not in self._failures and len(self._failures) < MOST_FAILURES:
            self._failures.add(failure)
            self._console.faults.append(failure)
        disturbs = failure is not None or isinstance(event, MasterRefused | ScenePaused | StepsTooSlow)
        tell = self._console.warn if disturbs else self._console.say
        listed = self._listed(event) if isinstance(event, MasterRefused) else None
        tell(in_words(event, listed), event=type(event).__name__, fields=fields_of(event, listed))

    def _listed(self, event: MasterRefused) -> str | None:
        """Return the name in the list of a master that was refused; None if it is not listed."""
        entry = None if self._guests is None or event.public is None else self._guests.roster.find(event.public)
        return None if entry is None else entry.name

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Renew the status line."""
        node = self._node
        if self._guests is not None and node.unkeyed and not self._said_unkeyed:
            self._said_unkeyed = True
            public = format_key(self._guests.own.public)
            self._console.warn(f"somebody asks for a session with another slave's key; this slave's is {public}")
        if node.draining and not self._said_draining:
            self._said_draining = True
            self._console.say(f"stopping: takes no new masters; {node.session_count} may finish (--drain)")
        if node.unread_hello is not None:
            reason, address = node.unread_hello
            if reason not in self._said_unread and len(self._said_unread) < MOST_UNREAD:
                self._said_unread.add(reason)
                self._console.warn(f"a HELLO from {place(address)} was dropped: {reason}")
        self._console.status(status(node))


def status(node: SlaveNode) -> str:
    """Return the status line of a slave."""
    steps, packets = node.totals()
    masters = f"{node.session_count} master{'s' * (node.session_count != 1)}"
    return f"{masters}, {steps} steps, {packets} packets sent"


def in_words(event: SlaveEvent, listed: str | None = None) -> str:
    """Return an event in words for a person; `listed` is the name in the list of a master that was refused."""
    if isinstance(event, MasterRefused):
        whose = "" if event.public is None else f" with the public key {format_key(event.public)}"
        own = repr(event.name) if listed is None else f"{listed!r} ({event.name!r})"
        return f"{own} from {place(event.address)}{whose} was refused: {event.reason}"
    if isinstance(event, StepsTooSlow):
        return str(event)
    session = event.context.session
    if isinstance(event, MasterJoined):
        request = session.request
        where = place(event.context.address)
        return f"{who(event.context)} joined from {where}: {request.codec}, asks for {request.rate_hz:g} Hz"
    if isinstance(event, ScenePaused):
        return f"{who(event.context)} feels nothing from now on: {event.reason}"
    if isinstance(event, SceneResumed):
        return f"{who(event.context)} feels the scene again"
    if isinstance(event, MasterLeft):
        return f"{who(event.context)} left: {session.end_reason} ({event.context.steps} steps)"
    raise TypeError(event)


def fields_of(event: SlaveEvent, listed: str | None = None) -> dict[str, Any]:
    """Return what an event is about, for programs; `listed` as for `in_words`."""
    if isinstance(event, StepsTooSlow):
        return {"code": event.what}
    about: dict[str, Any]
    if isinstance(event, MasterRefused):
        about = {"master": event.name, "address": place(event.address), "refusal": event.code.name}
    else:
        request, listed = event.context.session.request, event.context.listed
        about = {"master": request.name, "address": place(event.context.address), "codec": request.codec}
    return about if listed is None else {**about, "listed": listed}


def who(context: "SlaveContext") -> str:
    """Return what to call a master: its name in the list, and what it calls itself."""
    own = repr(context.session.request.name)
    return own if context.listed is None else f"{context.listed!r} ({own})"
