"""What a slave tells the program that runs it."""

from dataclasses import dataclass
from typing import TypeAlias

from hapticnet.node.hello_filter import Address
from hapticnet.node.slave_context import SlaveContext
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.protocol.messages import Code


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
    """The scene of a session raised an exception; its master feels nothing until `SlaveNode.resume`."""

    context: SlaveContext
    reason: str


@dataclass(frozen=True, slots=True)
class SceneResumed:
    """The scene of a session is stepped again after `ScenePaused`."""

    context: SlaveContext


@dataclass(frozen=True, slots=True)
class MasterRefused:
    """A master that has proved its address was refused a session, for `reason`.

    `public` is the public key it proved to have; None for an open session.
    """

    name: str
    address: Address
    public: bytes | None
    code: Code
    reason: str


SlaveEvent: TypeAlias = MasterJoined | MasterLeft | MasterRefused | ScenePaused | SceneResumed | StepsTooSlow
