"""Passivity control: a hand never gets more energy out of a contact than it put in.

The time-domain passivity observer and controller of Hannaford and Ryu, "Time-domain passivity control of haptic
interfaces" (2002). The observer adds up the work of the hand against the applied force. Where the force would soon
return more than that, the controller adds a damping force along the motion. So a delay, a loss or a codec cannot drive
the hand. The price is a force that differs from the true one where the sum would be negative, and only there.
"""

import math
from typing import Final

from hapticnet.samples import Vector
from hapticnet.vectors import along, dot, magnitude, minus, plus

SMALLEST_SQUARE_M2: Final = 1e-18
"""Squared movement [m²] between two ticks below which nothing is done: a nanometre."""


class PassivityController:
    """Observer and controller of one port.

    Every contact has an account of its own, which begins at zero: else the energy that a breach takes up would pay for
    what is created later.

    Parameters
    ----------
    axes
        Number of axes.
    contact_n
        Force [N] above which there is contact.

    Attributes
    ----------
    energy_j
        Work of the hand in this contact so far [J], less what it got back.
    damped_j
        Energy [J] that damping has taken, in all contacts.
    """

    __slots__ = ("_applied_n", "_position_m", "_zero_n", "contact_n", "damped_j", "energy_j")

    def __init__(self, axes: int, contact_n: float) -> None:
        self.energy_j = 0.0
        self.damped_j = 0.0
        self.contact_n = contact_n
        self._zero_n: Vector = (0.0,) * axes
        self._applied_n = self._zero_n
        self._position_m: Vector | None = None

    def limit(self, force_n: Vector, position_m: Vector) -> Vector:
        """Return the force [N] to apply until the next tick.

        It is `force_n`, plus damping along the motion if the account would become negative with another movement like
        the last one. Damping never exceeds the force: it neither turns it round nor more than doubles it.

        Parameters
        ----------
        force_n
            Force [N], positive when it pushes the tool out.
        position_m
            Position of the tool [m], which grows inward.
        """
        before_m, self._position_m = self._position_m, position_m
        if before_m is None:
            self._applied_n = force_n
            return force_n
        move_m = minus(position_m, before_m)
        # The mean of both ends, so that a spring gives back what it took. A force that is held from tick to tick gives
        # back a little more; that is so without a network, too, and much less than a person can tell.
        self.energy_j += 0.5 * dot(plus(self._applied_n, force_n), move_m)
        size_n = magnitude(force_n)
        if size_n <= self.contact_n and magnitude(self._applied_n) <= self.contact_n:
            self.energy_j = 0.0
        square_m2 = dot(move_m, move_m)
        expected_j = self.energy_j + 0.5 * dot(force_n, move_m)
        if expected_j < 0.0 and square_m2 > SMALLEST_SQUARE_M2:
            share = min(-2.0 * expected_j / square_m2, size_n / math.sqrt(square_m2))
            self.damped_j += share * square_m2
            force_n = along(force_n, share, move_m)
        self._applied_n = force_n
        return force_n
