"""The interface of what a master touches: a virtual scene, a robot, an engine, a recording."""

from collections.abc import Callable
from typing import Protocol

from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.ahead import LookAhead
from hapticnet.stiffness_bound import StiffnessBound


class Touchable(Protocol):
    """Something that answers each position with a force. `scene.Scene` is one.

    If it also has an attribute ``breaches``, recordings and reports show it: surfaces breached so far. If it has a
    method ``welcome(master: str)``, that is called once, before the first step, with the name of the master; an
    exception refuses the session. If it has a method ``ahead()``, that tells which layers can be met from the newest
    position on: a sequence of `scene.ahead.LayerAhead`, the nearest first, or None where it cannot tell now. It is
    called after a step, at most as often as ``step``, and must not wait.

    If it has a method ``stiffness_bound()``, that returns a `StiffnessBound` for the newest position, or None where it
    cannot tell now. Such a scene may be stepped at positions that the master did not send, but that are within the box
    of the newest bound. A robot that moves at each step may have it; one that must not move without an order must not.
    """

    @property
    def axes(self) -> int:
        """Number of axes of positions and forces."""
        ...

    @property
    def name(self) -> str:
        """Name in messages and reports, at most 64 bytes."""
        ...

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force at a position, positive when it pushes the operator out.

        Called for each position, in order of time, within the time of a tick: it must not wait. A SampleError refuses a
        position, which is counted; any other exception ends or pauses the session.
        """
        ...


def look_ahead_of(scene: Touchable) -> LookAhead | None:
    """Return the method ``ahead`` of a scene; None if it announces nothing."""
    ahead: LookAhead | None = getattr(scene, "ahead", None)
    return ahead


def bound_method(scene: Touchable) -> Callable[[], StiffnessBound | None] | None:
    """Return the method ``stiffness_bound`` of a scene; None if it takes only positions that were sent."""
    bound: Callable[[], StiffnessBound | None] | None = getattr(scene, "stiffness_bound", None)
    return bound


def breaches_of(scene: Touchable) -> int:
    """Return how many surfaces were breached so far; 0 if the scene does not know."""
    return int(getattr(scene, "breaches", 0))
