"""Time-domain passivity of a two-port: each end gives out no more energy than the other reports to have taken in.

After J.-H. Ryu, J. Artigas and C. Preusche, "A passive bilateral control scheme for a teleoperator with time-varying
communication delay", Mechatronics 20 (2010). Observers count the energy that goes into the network at each end,
E = Σ F·dx where that is positive, and send the sum. A controller at each end holds what comes out against it:

- at the master a series resistance, F + αv, with the α that absorbs what the hand would get too much (impedance type);
- at the slave the movement is shortened (admittance type). The command always aims at the received position, so the
  drift that this causes is made up for as soon as energy allows it, as in V. Chawda, H. Van Quang, M. K. O'Malley and
  J.-H. Ryu, "Compensating position drift in Time Domain Passivity Approach based teleoperation", IEEE Haptics
  Symposium 2014.

The next movement of the hand is taken to be like the last, and the scene to be as stiff as in the last movement.
Where that is wrong, too much is given out, and held back later: at most one tick's at the master, when the hand
turns, and at the slave the tool's first two movements into a contact, until it knows the stiffness; over loss some µJ
more. With an α above twice the hand's mass over the period of a tick, a sampled damper shakes the hand instead of
damping it. A bound of α prevents that, but then energy can come out that has not gone in.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Final

from hapticnet.checks import check_above
from hapticnet.control.ports import Port
from hapticnet.samples import Vector
from hapticnet.vectors import along, dot, magnitude, minus, plus, times
from hapticnet_literature.totals import BYTES, Totals, packed
from hapticnet_literature.touch import Touch

STEP_J: Final = 1e-7  # count of energy on the wire [J]; the sums are rounded down

SMALLEST_SQUARE_M2: Final = 1e-18  # below this square of a movement [m²], damping would not be finite


class TdpaMaster:
    """Observer and controller at the master. Satisfies `ports.MasterEnd`."""

    def __init__(self, port: Port, most_damping: float) -> None:
        self.taken_in_j = 0.0  # energy that has gone into the network here [J]
        self.given_out_j = 0.0  # what has come out of it, less what damping has absorbed
        self._most_n = port.max_force_n
        self._most = 1e6 * most_damping / port.period_us  # damping force per movement of a tick [N/m]
        self._reported = Totals(1, STEP_J)
        self._reported_j = 0.0  # what has gone in at the slave
        self._position_m: Vector | None = None
        self._move_m: Vector = ()
        self._asked_n = self._applied_n = (0.0,) * port.axes
        self._observed = False  # whether this tick's movement is counted
        self._ticks = self.held_back = 0

    def outgoing(self, position_m: Vector, now_us: int) -> bytes:  # noqa: ARG002
        """Return the energy that has gone in."""
        self._observe(position_m)
        return packed((self.taken_in_j,), STEP_J)

    def incoming(self, data: bytes) -> None:
        """Note the energy that has gone in at the slave."""
        self._reported_j = max(self._reported_j, *self._reported.receive(data))

    def limit(self, force_n: Vector, position_m: Vector, now_us: int, *, follows: bool) -> Vector:  # noqa: ARG002
        """Return the force [N], damped if the next movement would otherwise give out too much."""
        if not self._observed:
            self._observe(position_m)
        self._observed = False
        self._ticks += 1
        size_n = magnitude(force_n)
        if size_n > self._most_n:
            force_n, size_n = times(force_n, self._most_n / size_n), self._most_n
        self._asked_n = self._applied_n = force_n
        square_m2 = dot(self._move_m, self._move_m) if self._move_m else 0.0
        if square_m2 > SMALLEST_SQUARE_M2:
            lacking_j = self.given_out_j - self._reported_j - min(dot(force_n, self._move_m), 0.0)
            if lacking_j > 0.0:
                # Damping never reverses nor more than doubles a force.
                share = min(lacking_j / square_m2, size_n / math.sqrt(square_m2), self._most)
                self._applied_n = along(force_n, share, self._move_m)
                self.held_back += 1
        return self._applied_n

    def report(self) -> dict[str, float]:
        """Return the share of damped ticks, and the energy that the two ends have taken in [J]."""
        share = self.held_back / self._ticks if self._ticks else 0.0
        return {"held_back_share": share, "taken_in_j": self.taken_in_j, "reported_j": self._reported_j}

    def _observe(self, position_m: Vector) -> None:
        """Count the energy of the movement since the last tick."""
        before_m, self._position_m, self._observed = self._position_m, position_m, True
        if before_m is None:
            return
        self._move_m = minus(position_m, before_m)
        work_j = dot(self._asked_n, self._move_m)
        if work_j > 0.0:
            self.taken_in_j += work_j
        else:
            self.given_out_j -= work_j
        self.given_out_j -= dot(minus(self._applied_n, self._asked_n), self._move_m)


class TdpaSlave:
    """Observer and controller at the slave. Satisfies `ports.SlaveEnd`."""

    def __init__(self, port: Port) -> None:
        self.taken_in_j = self.given_out_j = 0.0
        self._reported = Totals(1, STEP_J)
        self._reported_j = 0.0
        self._touch = Touch(port.axes)

    def command(self, position_m: Vector, t_us: int, data: bytes) -> Vector:  # noqa: ARG002
        """Return the position [m] nearest to the received one that the energy allows."""
        self._reported_j = max(self._reported_j, *self._reported.receive(data))
        touch = self._touch
        touch.tool_m = position_m
        if touch.position_m is not None and touch.force_n != (0.0,) * len(position_m):
            move_m = minus(position_m, touch.position_m)
            share = self._share(dot(touch.force_n, move_m), 0.5 * touch.stiffness * dot(move_m, move_m))
            touch.tool_m = along(touch.position_m, share, move_m)
        return touch.tool_m

    def answer(self, force_n: Vector) -> tuple[Vector, bytes]:
        """Return the scene's force, and the energy that has gone into the network here."""
        touch = self._touch
        if touch.position_m is not None:
            # The mean of both ends, so that a spring gives back what it took.
            work_j = 0.5 * dot(plus(touch.force_n, force_n), minus(touch.tool_m, touch.position_m))
            if work_j > 0.0:
                self.given_out_j += work_j
            else:
                self.taken_in_j -= work_j
        touch.feel(force_n)
        return force_n, packed((self.taken_in_j,), STEP_J)

    def _share(self, first_j: float, second_j: float) -> float:
        """Return the largest share s ≤ 1 of a movement whose energy s·first + s²·second is available."""
        available_j = max(self._reported_j - self.given_out_j, 0.0)
        if first_j + second_j <= available_j:
            return 1.0
        if second_j <= 0.0:
            return available_j / first_j
        return (math.sqrt(first_j * first_j + 4.0 * second_j * available_j) - first_j) / (2.0 * second_j)


@dataclass(frozen=True, slots=True)
class Tdpa:
    """Damp the hand and shorten the tool's way where energy would come out that has not gone in.

    Attributes
    ----------
    most_damping
        Largest damping α of the hand [N·s/m]; by default its force, which never exceeds the slave's, is the only bound.
    """

    name: ClassVar[str] = "tdpa"
    most_damping: float = 1e6

    def __post_init__(self) -> None:
        check_above("largest damping", self.most_damping, 0.0, 1e6, "N·s/m")

    def forward_bytes(self, axes: int) -> int:  # noqa: ARG002
        """Return the length of the master's energy [B]."""
        return BYTES

    def feedback_bytes(self, axes: int) -> int:  # noqa: ARG002
        """Return the length of the slave's energy [B]."""
        return BYTES

    def master(self, port: Port) -> TdpaMaster:
        """Return a new end at the master."""
        return TdpaMaster(port, self.most_damping)

    def slave(self, port: Port) -> TdpaSlave:
        """Return a new end at the slave."""
        return TdpaSlave(port)
