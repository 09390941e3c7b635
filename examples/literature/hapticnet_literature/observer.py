"""Passivity observer and controller of one port, at the master.

After B. Hannaford and J.-H. Ryu, "Time-domain passivity control of haptic interfaces", IEEE Transactions on Robotics
and Automation 18 (2002). The observer sums the work of the hand; damping F + αv absorbs what the hand would get back
beyond it. Every contact has its own account here, which begins at zero: otherwise energy that a breach has absorbed
could come out again in a later contact.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Final

from hapticnet.control.ports import Port
from hapticnet.samples import Vector
from hapticnet.vectors import along, dot, magnitude, minus, plus

SMALLEST_SQUARE_M2: Final = 1e-18  # below this square of a movement [m²], damping would not be finite


class PassivityController:
    """Observer and controller. Satisfies `ports.MasterEnd`.

    There is contact above a force of `contact_n` [N].
    """

    def __init__(self, axes: int, contact_n: float) -> None:
        self.energy_j = 0.0  # work of the hand in this contact so far [J], less what it got back
        self.damped_j = 0.0  # energy [J] absorbed by damping, in all contacts
        self._contact_n = contact_n
        self._applied_n: Vector = (0.0,) * axes
        self._position_m: Vector | None = None
        self._ticks = self.held_back = 0

    def report(self) -> dict[str, float]:
        """Return the share of damped ticks, and the energy that damping has absorbed [J]."""
        return {"held_back_share": self.held_back / self._ticks if self._ticks else 0.0, "damped_j": self.damped_j}

    def limit(self, force_n: Vector, position_m: Vector, now_us: int, *, follows: bool) -> Vector:  # noqa: ARG002
        """Return the force [N] to apply until the next tick.

        It is `force_n`, plus damping along the motion if the account would become negative after another movement like
        the last one. Damping never exceeds the force: it neither reverses nor more than doubles it.
        """
        self._ticks += 1
        before_m, self._position_m = self._position_m, position_m
        if before_m is None:
            self._applied_n = force_n
            return force_n
        move_m = minus(position_m, before_m)
        # The mean of both ends, so that a spring gives back what it took. A force that is held from tick to tick gives
        # back a little more; this happens without a network too, and is far below what a person can feel.
        self.energy_j += 0.5 * dot(plus(self._applied_n, force_n), move_m)
        size_n = magnitude(force_n)
        if size_n <= self._contact_n and magnitude(self._applied_n) <= self._contact_n:
            self.energy_j = 0.0
        square_m2 = dot(move_m, move_m)
        expected_j = self.energy_j + 0.5 * dot(force_n, move_m)
        if expected_j < 0.0 and square_m2 > SMALLEST_SQUARE_M2:
            share = min(-2.0 * expected_j / square_m2, size_n / math.sqrt(square_m2))
            self.damped_j += share * square_m2
            self.held_back += 1
            force_n = along(force_n, share, move_m)
        self._applied_n = force_n
        return force_n


@dataclass(frozen=True, slots=True)
class Passive:
    """Damp the hand where it would get back more energy than it has put in."""

    name: ClassVar[str] = "passive"

    def master(self, port: Port) -> PassivityController:
        """Return a new observer and controller."""
        return PassivityController(port.axes, port.law.floor_n)
