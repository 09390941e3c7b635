"""The interface of couplings: what a package implements, and where it acts."""

import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector


class Port(NamedTuple):
    """Where a coupling acts."""

    axes: int
    law: WeberLaw  # the JND of the session
    period_us: int  # time between two ticks of the master [µs]
    max_force_n: float = math.inf  # largest force [N] that the device renders
    scale: float = 1.0  # movement of the tool over that of the hand
    applied_n: Callable[[], Vector] | None = None  # the force [N] of the last tick, where the device knows it


class MasterEnd(Protocol):
    """The end of a coupling at the master. `held_back` counts the ticks at which it has changed the force."""

    held_back: int

    def limit(self, force_n: Vector, position_m: Vector, now_us: int, *, follows: bool) -> Vector:
        """Return the force [N] to apply until the next tick; `follows`: the force is a function of this position."""

    def report(self) -> dict[str, float]:
        """Return its figures for JSON."""


class TwoPortMasterEnd(MasterEnd, Protocol):
    """The end at the master of a coupling that has one at the slave too."""

    def outgoing(self, position_m: Vector, now_us: int) -> bytes:
        """Return the data that precedes a position, `TwoPort.forward_bytes` long."""

    def incoming(self, data: bytes) -> None:
        """Process the data that preceded a force; raise PeerError if it is malformed."""


class SlaveEnd(Protocol):
    """The end of a coupling at the slave, for one session."""

    def command(self, position_m: Vector, t_us: int, data: bytes) -> Vector:
        """Return the position [m] to which the scene is stepped; raise PeerError if the data is malformed."""

    def answer(self, force_n: Vector) -> tuple[Vector, bytes]:
        """Return the vector [N] to encode for the scene's force, and the data that precedes its payload."""


class Coupling(Protocol):
    """A coupling and its parameters: a frozen dataclass whose fields are numbers with defaults."""

    name: ClassVar[str]

    def master(self, port: Port) -> MasterEnd | None:
        """Return a new end at the master; None if it does nothing there."""


@runtime_checkable
class TwoPort(Coupling, Protocol):
    """A coupling in which the slave takes part: its master asks for it, and each session has new ends."""

    def master(self, port: Port) -> TwoPortMasterEnd | None:
        """Return a new end at the master; None if it does nothing there."""

    def slave(self, port: Port) -> SlaveEnd:
        """Return a new end at the slave."""

    def forward_bytes(self, axes: int) -> int:
        """Return the length of the data before each position [B]."""

    def feedback_bytes(self, axes: int) -> int:
        """Return the length of the data before each force [B]."""
