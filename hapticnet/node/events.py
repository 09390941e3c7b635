"""Events of master and slave for the program that runs them, and the settings in force at a master."""

from collections import deque
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, TypeAlias

from hapticnet.node.fingertip import FingertipEvent
from hapticnet.node.slave_context import SlaveContext
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.protocol.hello_filter import Address
from hapticnet.protocol.messages import Code, Grant, Request
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

CHANGES_KEPT: Final = 1000
"""Changes that a node keeps; beyond that, the oldest are dropped. A slider on the page makes dozens a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingsInForce:
    """All settings in force, from the first force applied under them: at the first session and after each change."""

    # the feedback codec and the JND. With a `position_share` the codec has the rest of the JND.
    codec: str
    parameters: dict[str, float]
    weber_fraction: float
    floor_n: float
    multiplier: float
    rate_hz: float  # this and the next three as the slave has granted them
    position_share: float
    announced: bool
    predicted: bool
    coupling: str  # its name; "direct" for one that only the master knows
    scene: str
    # networks that are emulated at this end, as written for ``--channel-out``; None: none
    channel_out: str | None = None
    channel_in: str | None = None

    @classmethod
    def of(cls, request: Request, grant: Grant) -> "SettingsInForce":
        """Return the settings of a session, without emulated networks."""
        return cls(
            codec=request.codec,
            parameters=request.parameters,
            weber_fraction=request.weber_fraction,
            floor_n=request.floor_n,
            multiplier=request.multiplier,
            rate_hz=min(request.rate_hz, grant.rate_hz),
            position_share=grant.position_share,
            announced=grant.announced,
            predicted=grant.predicted,
            coupling="direct" if request.coupling is None else request.coupling[0],
            scene=grant.scene,
        )


class InForce:
    """Settings in force and their history."""

    def __init__(self) -> None:
        self.history: deque[tuple[int, SettingsInForce]] = deque(maxlen=CHANGES_KEPT)  # [µs] and settings; newest last
        self._session: SettingsInForce | None = None
        self._channels: tuple[str | None, str | None] = (None, None)

    def begin(self, session: SettingsInForce, now_us: int) -> tuple[SettingsInForce, ...]:
        """Note that a session is in force from now on; return its settings, or None if they are not new."""
        self._session = session
        new = replace(session, channel_out=self._channels[0], channel_in=self._channels[1])
        if self.history and self.history[-1][1] == new:
            return ()
        self.history.append((now_us, new))
        return (new,)

    def emulate(self, channel_out: str | None, channel_in: str | None, now_us: int) -> tuple[SettingsInForce, ...]:
        """Note the networks emulated from now on; return like `begin`, and None before a session."""
        self._channels = channel_out, channel_in
        return () if self._session is None else self.begin(self._session, now_us)

    def report(self) -> list[dict[str, Any]]:
        """Return the history for JSON; `t_s` counts from the first session."""
        return [{"t_s": (t_us - self.history[0][0]) / 1e6, **asdict(each)} for t_us, each in self.history]


@dataclass(frozen=True, slots=True)
class Failed:
    """Operator, codec or device raised an exception: the force goes to zero and the session is closed."""

    reason: str


@dataclass(frozen=True, slots=True)
class HeldBack:
    """The coupling holds the force back, because the hand would oscillate against it; told about once a contact."""


@dataclass(frozen=True, slots=True)
class Paused:
    """The operator raised an exception: the force goes to zero and the operator is not called until `resume`."""

    reason: str


@dataclass(frozen=True, slots=True)
class Resumed:
    """The operator is called again after `Paused`."""


NodeEvent: TypeAlias = (
    Connected
    | SettingsInForce
    | LinkStale
    | LinkRecovered
    | SessionLost
    | Refused
    | ChangeRefused
    | Hinted
    | Noticed
    | HeldBack
    | StepsTooSlow
    | Paused
    | Resumed
    | Failed
    | Ended
    | FingertipEvent
)
"""Events that a master reports; forces and confirmations stay inside."""


@dataclass(frozen=True, slots=True)
class MasterJoined:
    """A master has a session."""

    context: SlaveContext


@dataclass(frozen=True, slots=True)
class MasterLeft:
    """A master's session has ended; `context` holds its final account."""

    context: SlaveContext


@dataclass(frozen=True, slots=True)
class ScenePaused:
    """The scene of a session raised an exception; its master gets no force until `SlaveNode.resume`."""

    context: SlaveContext
    reason: str


@dataclass(frozen=True, slots=True)
class SceneResumed:
    """The scene of a session is stepped again after `ScenePaused`."""

    context: SlaveContext


@dataclass(frozen=True, slots=True)
class SceneSaid:
    """The scene of a session has a message for a person, such as that its robot has stopped."""

    context: SlaveContext
    line: str


@dataclass(frozen=True, slots=True)
class MasterRefused:
    """A master with a proved address was refused; `public` is the key it proved to have, None: an open session."""

    name: str
    address: Address
    public: bytes | None
    code: Code
    reason: str


SlaveEvent: TypeAlias = (
    MasterJoined | MasterLeft | MasterRefused | ScenePaused | SceneResumed | SceneSaid | StepsTooSlow
)
