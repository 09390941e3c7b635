"""The coupling at a master, and the checks of what it returns."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from hapticnet.checks import axes_of
from hapticnet.control.couplings import data_bytes, parameters_of, parse_coupling
from hapticnet.control.energy_bound import EnergyBound
from hapticnet.control.ports import MasterEnd, Port, TwoPort
from hapticnet.errors import HapticnetError, PeerError, SampleError, SettingsError, in_words
from hapticnet.node.events import HeldBack
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.base import Operator
from hapticnet.parts import KINDS, Part, PartsLaw
from hapticnet.perception import WeberLaw
from hapticnet.rotations import ORIGIN, Quaternion, inverse, product, quaternion_of, vector_near
from hapticnet.samples import Vector, checked_vector
from hapticnet.vectors import magnitude, over, plus, times

if TYPE_CHECKING:
    from hapticnet.capabilities import Capabilities

HELD_BACK_EVERY_US: Final = 5_000_000  # a force that is held back is reported again after so long without one [µs]


class CouplingFailedError(HapticnetError):
    """A coupling raised an exception, or returned something that cannot be used."""


@contextmanager
def catching() -> Iterator[None]:
    """Turn every exception but PeerError into CouplingFailedError."""
    try:
        yield
    except PeerError:
        raise
    except Exception as error:
        raise CouplingFailedError(f"the coupling failed: {in_words(error)}") from error


def ports_of_parts(port: Port, law: PartsLaw) -> list[Port]:
    """Return the port of each part. Each force has the force limit of the device; torque and grip have none.

    A torque acts as the force at `LEVER_M` with the same work, because dampings and stiffnesses are those of movements.
    """
    ports = []
    for part, each, own in zip(law.parts, law.slices(), law.laws, strict=True):
        lever, of_device = KINDS[part.kind].m_per_unit, port.applied_n
        ports.append(
            port._replace(
                axes=part.axes,
                law=replace(own, floor_n=own.floor_n / lever),
                max_force_n=port.max_force_n if part.kind == "force" else math.inf,
                applied_n=None if of_device is None else partial(_part_of, of_device, each, lever),
            )
        )
    return ports


def _part_of(applied_n: Callable[[], Vector], each: slice, lever: float) -> Vector:
    return over(applied_n()[each], lever)


def _within(force_n: Vector, most_n: float) -> Vector:
    size_n = magnitude(force_n)
    return force_n if size_n <= most_n else times(force_n, most_n / size_n)


class Way:
    """The movement of a part, as places whose difference times the stimulus is the work.

    A torque on three axes works along the turn itself, which is the difference of two rotation vectors only about a
    fixed axis. The places add up the turns from tick to tick.
    """

    def __init__(self, part: Part) -> None:
        self._turns = part.kind == "torque" and part.axes == 3
        self._last: Quaternion | None = None
        self._place: Vector = ORIGIN

    def to(self, position: Vector) -> Vector:
        """Return the place after the movement to a position."""
        if not self._turns:
            return position
        turn = quaternion_of(position)
        if self._last is not None:
            self._place = plus(self._place, vector_near(product(turn, inverse(self._last))))
        self._last = turn
        return self._place


class PartsEnd:
    """An end for each part. Each is passive at its own port, so all together are. Satisfies `MasterEnd`."""

    def __init__(self, law: PartsLaw, ends: Sequence[MasterEnd]) -> None:
        levers = [KINDS[part.kind].m_per_unit for part in law.parts]
        self._labels = tuple(part.label for part in law.parts)
        self._ends = tuple(zip(law.slices(), levers, ends, strict=True))
        self._ways = tuple(map(Way, law.parts))
        self.held_back = 0

    def set_law(self, law: PartsLaw) -> None:
        """Set the law of every end."""
        for (_, lever, end), own in zip(self._ends, law.laws, strict=True):
            if isinstance(end, EnergyBound):
                end.law = replace(own, floor_n=own.floor_n / lever)

    def limit(self, force_n: Vector, position_m: Vector, now_us: int, *, follows: bool) -> Vector:
        """Return the stimulus to apply until the next tick. See `MasterEnd.limit`."""
        limited: list[float] = []
        for (each, lever, end), way in zip(self._ends, self._ways, strict=True):
            place_m = times(way.to(position_m[each]), lever)
            limited += times(end.limit(over(force_n[each], lever), place_m, now_us, follows=follows), lever)
        self.held_back = sum(end.held_back for _, _, end in self._ends)
        return tuple(limited)

    def report(self) -> dict[str, dict[str, float]]:
        """Return the figures of each part for JSON."""
        return {label: end.report() for label, (_, _, end) in zip(self._labels, self._ends, strict=True)}


class MasterCoupling:
    """The coupling of one master, over all of its sessions. Raise CouplingFailedError if it cannot be used."""

    def __init__(
        self, settings: MasterSettings, law: WeberLaw, operator: Operator, period_us: int, device_n: float
    ) -> None:
        self._coupling: Any = parse_coupling(settings.coupling)
        applied_n = (lambda: operator.applied_n) if hasattr(operator, "applied_n") else None
        moved: Capabilities | None = getattr(operator, "capabilities", None)  # of the device in the hand
        max_force_n = device_n if moved is None else min(device_n, moved.max_force_n)
        scale = getattr(operator, "scale", 1.0)
        self._port = Port(operator.axes, law, period_us, max_force_n, scale, applied_n)
        self.request: tuple[str, dict[str, float]] | None = None  # what the slave is asked for, if it takes part
        self._forward_bytes = self.feedback_bytes = 0  # data before a position and before a force [B]
        self._held_us = -HELD_BACK_EVERY_US  # last `check` [µs] before which the force was held back
        if isinstance(law, PartsLaw) and isinstance(self._coupling, TwoPort):
            raise SettingsError(
                f"coupling {self._coupling.name!r} has an end at the slave, which is for one part only; positions have"
                f" {len(law.parts)}"
            )
        with catching():
            if isinstance(self._coupling, TwoPort):
                self.request = self._coupling.name, parameters_of(self._coupling)
                self._forward_bytes, self.feedback_bytes = data_bytes(self._coupling, operator.axes)
            # its ends at the master, or None: of the newest session, and of the one whose forces are applied
            self.newest: Any = self._end(self._port)
            self._applied = self.newest
            # ticks at which the applied end has changed the force: so far, and until the last `check`
            self._held_back = self._noted = 0 if self.newest is None else int(self.newest.held_back)

    def _end(self, port: Port) -> Any:
        """Return a new end at the master, of all parts if there are several; None if it does nothing there."""
        if not isinstance(port.law, PartsLaw):
            return self._coupling.master(port)
        ends = [self._coupling.master(each) for each in ports_of_parts(port, port.law)]
        return None if None in ends else PartsEnd(port.law, ends)

    @property
    def limits(self) -> bool:
        """Whether it may change forces at the master."""
        return self._applied is not None

    def begin(self, law: WeberLaw) -> None:
        """Make an end for a newly granted session; the old one limits forces until `switch`."""
        if self.request is not None:
            with catching():
                self.newest = self._end(self._port._replace(law=law))
        elif isinstance(self.newest, EnergyBound):  # its account goes on
            self.newest.law = law
        elif isinstance(self.newest, PartsEnd) and isinstance(law, PartsLaw):
            self.newest.set_law(law)

    def switch(self) -> None:
        """Note that the forces of the newest session are applied from now on."""
        if self._applied is not self.newest:
            self._applied, self._held_back, self._noted = self.newest, 0, 0

    def outgoing(self, position_m: Vector, now_us: int) -> bytes:
        """Return the data that precedes a position of the newest session."""
        if self._forward_bytes == 0:
            return b""
        with catching():
            data = self.newest.outgoing(position_m, now_us)
            if type(data) is not bytes or len(data) != self._forward_bytes:
                raise ValueError(f"its data is {data!r}; it must have {self._forward_bytes} bytes")
        return data

    def limit(self, force_n: Vector, position_m: Vector, now_us: int, *, follows: bool) -> Vector:
        """Return the force [N] to apply until the next tick; `follows`: it is a function of this position."""
        if self._applied is None:
            return force_n
        with catching():
            force_n = checked_vector(self._applied.limit(force_n, position_m, now_us, follows=follows), "its force")
            self._held_back = int(self._applied.held_back)
            if len(force_n) != self._port.axes:
                raise SampleError(f"its force has {axes_of(len(force_n))}; the operator has {self._port.axes}")
        law, most_n = self._port.law, self._port.max_force_n
        if not isinstance(law, PartsLaw):
            return _within(force_n, most_n)
        parts = zip(law.parts, law.slices(), strict=True)
        return tuple(
            [x for part, at in parts for x in _within(force_n[at], most_n if part.kind == "force" else math.inf)]
        )

    def check(self, now_us: int) -> tuple[HeldBack, ...]:
        """Return what to tell the operator: that the force is held back, about once a contact."""
        if self._held_back == self._noted:
            return ()
        before_us, self._held_us, self._noted = self._held_us, now_us, self._held_back
        return (HeldBack(),) if now_us - before_us > HELD_BACK_EVERY_US else ()

    def report(self) -> dict[str, Any]:
        """Return the report for JSON."""
        try:
            return {"name": self._coupling.name, **({} if self._applied is None else self._applied.report())}
        except Exception as error:  # a user's coupling may raise anything
            return {"name": self._coupling.name, "failed": in_words(error)}
