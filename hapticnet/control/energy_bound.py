"""A bound on the force from the energy at the master's port: a late force cannot feed an oscillation.

The hand puts the work F·dx into the port, and gets it back when it retreats. Over a delay it gets back more than it put
in, and an oscillation grows. Here an account E holds what was put in, and the force is at most

    |F| ≤ √(2 K E),    K = 2 b / T

the force of a spring of stiffness K that holds the energy E. A retreat along it returns E and no more. K is the
largest stiffness that a tick of T and a damping b of hand and device allow: b > K·T/2 (J. E. Colgate and G. Schenkel,
"Passivity of a class of sampled-data systems: application to haptic interfaces", Journal of Robotic Systems 14, 1997).
A true spring below K always holds enough, and is not changed. A controller that adds damping instead, like that of
Hannaford and Ryu (2002), has to cancel the whole force within a tick, tick after tick; this bound changes as smoothly
as the motion.

What fills the account
- The work of the hand, and the energy b·v²·dt that its damping absorbs.
- An allowance, because the first force of a contact arrives late, before the hand has done any work. It is renewed
  while the hand rests.
- The energy of the true spring, once the force has followed the position without a correction for `CONFIRMED_US`: the
  force is then a function of the position, which cannot feed an oscillation. A correction is a change that is larger
  than half a JND and than K·|dx|.

Until then the account never holds more than the allowance and what the force could have stored since the contact began
(F times depth). Otherwise energy that a breach or a damper has absorbed would allow an oscillation later.
"""

import math
from typing import Final

from hapticnet.checks import check_above, check_parameter
from hapticnet.control.ports import Port
from hapticnet.samples import Vector
from hapticnet.vectors import along, dot, magnitude, minus, times

FIRST_N: Final = 2.0  # largest force [N] that the allowance allows, however stiff K is

CONFIRMED_US: Final = 300_000
"""Time [µs] without a correction after which a force that follows the position counts as confirmed: longer than the
round trips at which touch is of use (200 ms), within which a wrong law is not contradicted yet."""

FILLED_IN_S: Final = 0.2
"""Time constant [s] with which the account of a confirmed force is filled: slower than the oscillations of an arm."""

LONGEST_S: Final = 0.02  # longest time [s] between two ticks; after a pause, nothing is credited for it

SMOOTHED_S: Final = 0.01  # time constant [s] of the velocity at which the hand absorbs energy

AT_REST_M_PER_S: Final = 1e-3
"""Speed [m/s] below which the hand counts as at rest: that of a swing of 0.1 mm at 3 Hz."""

RESTED_US: Final = 200_000  # time [µs] at rest after which the allowance is renewed: no swing rests so long

REFILLED_IN_S: Final = 0.5  # time constant [s] with which the allowance is renewed at rest

SMALLEST_MOVE_M: Final = 1e-6  # movement [m] from which a stiffness follows

TOLERANCE: Final = 1.2  # of the stiffness seen, which is an estimate, over K

LARGEST_DEPTH_M: Final = 0.1  # deepest contact [m] of a force that counts as that of a spring


class EnergyBound:
    """The energy account of one port. Satisfies `ports.MasterEnd`."""

    def __init__(self, port: Port, damping_n_s_per_m: float, allowance_j: float) -> None:
        check_above("damping of hand and device", damping_n_s_per_m, 0.0, 1e4, "N·s/m")
        check_parameter("allowance of a contact", allowance_j, 0.0, 1.0, "J")
        self.law, self._max_force_n, self._damping = port.law, port.max_force_n, damping_n_s_per_m
        self._scale, self._of_device_n = port.scale, port.applied_n
        self._stiffest = 2e6 * damping_n_s_per_m / port.period_us  # [N/m]
        self.energy_j = self._allowance_j = min(allowance_j, 0.5 * FIRST_N * FIRST_N / self._stiffest)
        self._applied_n: Vector = ()
        self._asked_n: Vector = ()
        self._position_m: Vector | None = None
        self._velocity_m_per_s: Vector = ()
        self._began_m: Vector = ()  # where the present contact began
        self._now_us = self._confirmed_us = self._moved_us = 0
        self._squares_m2 = self._product_j = 0.0  # for the stiffness since the last correction
        self._ticks = self.held_back = 0

    def report(self) -> dict[str, float]:
        """Return the share of ticks at which the force was held back, and the energy in the account [J]."""
        return {"held_back_share": self.held_back / self._ticks if self._ticks else 0.0, "energy_j": self.energy_j}

    def limit(self, force_n: Vector, position_m: Vector, now_us: int, *, follows: bool) -> Vector:
        """Return the force [N] to apply until the next tick. See `ports.MasterEnd.limit`."""
        self._ticks += 1
        if self._scale != 1.0:  # energy is that of the hand's own movement
            position_m = times(position_m, 1.0 / self._scale)
        size_n, before_m = magnitude(force_n), self._position_m
        if not math.isfinite(size_n):
            return (0.0,) * len(force_n)
        if size_n > self._max_force_n:
            force_n, size_n = times(force_n, self._max_force_n / size_n), self._max_force_n
            follows = False  # what the device renders is not the law of the tissue any more
        if before_m is None or len(before_m) != len(position_m):
            self._begin(force_n, position_m, now_us)
        else:
            move_m, elapsed_s = minus(position_m, before_m), 1e-6 * (now_us - self._now_us)
            square_m2 = dot(move_m, move_m)
            elapsed_s = elapsed_s if 0.0 < elapsed_s <= LONGEST_S else 0.0
            work_j = dot(self._applied_n if self._of_device_n is None else self._of_device_n(), move_m)
            self.energy_j += work_j
            if elapsed_s:
                # Smoothed, because each step of a position sensor would look like a fast motion.
                share = min(elapsed_s / SMOOTHED_S, 1.0)
                self._velocity_m_per_s = along(times(self._velocity_m_per_s, 1.0 - share), share / elapsed_s, move_m)
                square = dot(self._velocity_m_per_s, self._velocity_m_per_s)
                self.energy_j += self._damping * square * elapsed_s
                if square > AT_REST_M_PER_S * AT_REST_M_PER_S:
                    self._moved_us = now_us
                elif now_us - self._moved_us > RESTED_US:
                    self.energy_j += max(self._allowance_j - self.energy_j, 0.0) * elapsed_s / REFILLED_IN_S
            self.energy_j = max(self.energy_j, 0.0)
            self._watch(force_n, size_n, move_m, square_m2, now_us)
            if size_n <= self.law.floor_n:
                self._began_m, self._squares_m2, self._product_j = position_m, 0.0, 0.0
            stored_j = max(dot(force_n, minus(position_m, self._began_m)), 0.0) + self._allowance_j
            if follows and now_us - self._confirmed_us > CONFIRMED_US and size_n > self.law.floor_n:
                missing_j = self._confirmed_j(force_n, size_n, position_m) - self.energy_j
                if work_j >= 0.0:  # not while the force drives the hand
                    self.energy_j += max(missing_j, 0.0) * elapsed_s / FILLED_IN_S
            else:
                self.energy_j = min(self.energy_j, stored_j)
        self._position_m, self._now_us, self._asked_n = position_m, now_us, force_n
        most_n = math.sqrt(2.0 * self._stiffest * self.energy_j)
        self._applied_n = force_n
        if size_n > most_n:
            self.held_back += 1
            self._applied_n = times(force_n, most_n / size_n)
        return self._applied_n

    def _begin(self, force_n: Vector, position_m: Vector, now_us: int) -> None:
        self._began_m, self._asked_n = position_m, force_n
        self._applied_n = self._velocity_m_per_s = (0.0,) * len(force_n)
        self._confirmed_us = now_us

    def _watch(self, force_n: Vector, size_n: float, move_m: Vector, square_m2: float, now_us: int) -> None:
        """Note whether the force has followed the position, and how stiffly."""
        change_n = minus(force_n, self._asked_n)
        if magnitude(change_n) > self._stiffest * math.sqrt(square_m2) + 0.5 * self.law.jnd_n(size_n):
            self._confirmed_us = now_us
            self._squares_m2 = self._product_j = 0.0
        else:
            self._squares_m2 += square_m2
            self._product_j += dot(change_n, move_m)

    def _confirmed_j(self, force_n: Vector, size_n: float, position_m: Vector) -> float:
        """Return the energy [J] that a spring of the stiffness seen lately holds at a force [N]; 0 if too stiff."""
        least_j = 0.5 * size_n * size_n / self._stiffest
        if self._squares_m2 <= SMALLEST_MOVE_M * SMALLEST_MOVE_M:
            return least_j if size_n < self._stiffest * LARGEST_DEPTH_M else 0.0
        stiffness = self._product_j / self._squares_m2
        if stiffness > TOLERANCE * self._stiffest:
            return 0.0
        if stiffness * LARGEST_DEPTH_M < size_n:  # a force that hardly changes is not that of a spring
            return least_j
        self._began_m = minus(position_m, times(force_n, 1.0 / stiffness))
        return max(least_j, 0.5 * size_n * size_n / stiffness)
