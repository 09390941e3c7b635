"""What a master tells the person who watches it."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from hapticnet.node.events import Failed, NodeEvent, Paused, Resumed, SettingsInForce
from hapticnet.node.fingertip import DeviceFound, DeviceLost, FingerMet, FingerNotMet, ForceFault
from hapticnet.node.master import MasterNode
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.protocol.states import (
    ChangeRefused,
    Connected,
    Ended,
    Hinted,
    LinkRecovered,
    LinkStale,
    Noticed,
    Refused,
    SessionLost,
)
from hapticnet.recordings.session.session import settings_line
from hapticnet.runtime.trust import silence_advice
from hapticnet.runtime.watching import Watcher

if TYPE_CHECKING:
    from hapticnet.cli.console import Console
    from hapticnet.protocol.keys import MasterKey
    from hapticnet.protocol.messages import Code, Grant

ADVISE_AFTER: Final = 6  # status intervals without a session after which the operator is told what to check: 3 s


DISTURBANCES: Final = (
    LinkStale, SessionLost, Refused, ChangeRefused, Hinted, Noticed, StepsTooSlow, DeviceLost, Paused, Failed,
    ForceFault, FingerNotMet,
)  # fmt: skip
"""Events that are told as warnings: something does not work as it should, and the run goes on or ends safely."""


class MasterMessages(Watcher[NodeEvent]):
    """Messages about events, advice while there is no session, and the status line.

    `address`: the slave's address as written. `keys`: the keys of a sealed session; None for an open one.
    """

    name = "messages"

    def __init__(self, console: "Console", node: MasterNode, address: str, keys: "MasterKey | None") -> None:
        self.refusal: Code | None = None  # why the slave refused the first session, if it did
        self._console = console
        self._node = node
        self._address = address
        self._keys = keys
        self._hint: str | None = None
        self._intervals = 0
        self._unused: set[str] = set()

    def note(self, event: NodeEvent, now_us: int) -> None:  # noqa: ARG002 - messages have their own time
        """Tell what has happened."""
        if isinstance(event, SettingsInForce):  # for recordings: a person is told with the session, or asked for it
            return
        if isinstance(event, Connected):
            self._intervals = ADVISE_AFTER
        elif isinstance(event, Ended) and event.refused:
            self.refusal = event.code
        elif isinstance(event, Hinted):
            self._hint = event.reason
        failed = isinstance(event, Ended) and (event.refused or self._node.failure is not None)
        tell = self._console.warn if failed or isinstance(event, DISTURBANCES) else self._console.say
        about = {"master": self._node.settings.name, "address": self._address, "codec": self._node.codec.name}
        tell(in_words(event, self._node, self._address), event=type(event).__name__, fields=about)
        if isinstance(event, Connected):
            self._warn_of_unused(event.grant)

    def _warn_of_unused(self, grant: "Grant") -> None:
        """Warn, once, of what was asked for and the scene cannot do."""
        settings, why = self._node.settings, f"the scene {grant.scene} cannot tell how its force may change"
        line = settings.positions == "line" and not grant.position_share
        unused = {
            "--announced": (settings.announced and not grant.announced, f"the scene {grant.scene} announces nothing"),
            "--positions line": (line, f"{why}, so every position is sent"),
        }
        self._console.warn_of_unused({name: each for name, each in unused.items() if name not in self._unused})
        self._unused |= {name for name, (is_unused, _) in unused.items() if is_unused}

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Give advice if there is no session yet, and renew the status line."""
        self._intervals += 1
        if self._intervals == ADVISE_AFTER:
            self._console.warn(f"no session with {self._address} yet: {self.advice()}")
        self._console.status(status(self._node))

    def advice(self) -> str:
        """Return what to check while no slave answers."""
        return silence_advice(self._keys, self._node.session.received.malformed, self._hint)


def in_words(event: NodeEvent, node: MasterNode, address: str) -> str:
    """Return an event of `node` in words for a person; `address` is the slave's."""
    if isinstance(event, Connected):
        grant = event.grant
        resumed = ", as it was left" if grant.resumed else ""
        codec = node.codec
        jnd = "" if codec.name == "raw" else f" at {codec.law.multiplier:g} JND"
        return f"connected to {address}, scene {grant.scene}{resumed}, {grant.rate_hz:g} Hz granted, {codec.name}{jnd}"
    if isinstance(event, SettingsInForce):
        return f"in force: {settings_line(asdict(event))}"
    if isinstance(event, LinkStale):
        if event.too_old_us is not None:
            return (
                f"link too slow: forces answer positions {event.too_old_us / 1e6:.2f} s old, which is above --max-age;"
                " the held force decays to zero"
            )
        return "link stale: nothing arrived from the slave; the held force decays to zero"
    if isinstance(event, LinkRecovered):
        return "link recovered"
    if isinstance(event, SessionLost):
        return f"session lost ({event.reason}); asking for a new one"
    if isinstance(event, Refused):
        return f"the slave refuses a new session ({event.reason}); asking again in {event.retry_us / 1e6:g} s"
    if isinstance(event, ChangeRefused):
        return f"the slave refuses the change ({event.reason}); the session goes on as it was"
    if isinstance(event, Hinted):
        return f"unauthenticated refusal ({event.reason}); asking again"
    if isinstance(event, FingerMet):
        return f"finger touched at {1e3 * event.contact_m:.1f} mm, {event.stiffness_n_m / 1e3:.1f} N/mm"
    if isinstance(event, FingerNotMet):
        return f"finger not found, so the first force will search for it: {event.reason}"
    if isinstance(event, DeviceFound):
        return f"device ready: {event.description}"
    if isinstance(event, DeviceLost):
        return f"device lost ({event.reason}); the session goes on, the finger feels nothing"
    if isinstance(event, Paused):
        return f"{event.reason}; the force goes to zero until the operator is resumed"
    if isinstance(event, Resumed):
        return "the operator is asked again; the force rises from zero"
    if isinstance(event, Failed):
        return f"{event.reason}; the force goes to zero and the session is closed"
    if isinstance(event, Noticed):
        return f"the slave says: {event.reason}"
    if isinstance(event, StepsTooSlow):
        return str(event)
    if isinstance(event, ForceFault):
        return f"platform retracted: {event.reason}"
    return "session ended" if event.reason == node.failure else f"session ended: {event.reason}"


def status(node: MasterNode) -> str:
    """Return the status line of a master."""
    session = node.session
    round_trip_us = session.round_trip.percentile(50)
    held_n = ", ".join(f"{component:.2f}" for component in node.held_n)
    return (
        f"{session.state.value}, holding {held_n} N, {session.sent.packets} packets out,"
        f" {session.received.packets} in, {session.received.lost} lost"
        + (f", round trip {round_trip_us / 1000:.2f} ms" if round_trip_us else "")
    )
