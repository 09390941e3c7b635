"""An observer of the master's port: the energy that passes, and whether the hand begins to swing against a late force.

The hand puts energy in when it moves against the force, and gets it back when it retreats. A port that gives more than
it was given creates energy; here, as in `measure.energy`, every contact has its own account. Such a port feeds a swing:
the force rises and falls, each time at least as far as before, and in a whole cycle more energy comes out than goes in.
"""

from collections import deque
from itertools import pairwise
from typing import Final, NamedTuple

from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import distance, dot, magnitude, minus, plus

HALVES: Final = 5  # a swing is two rises and two falls, and begins with another
SMALLEST_JND: Final = 2.0  # smaller ones [JND] are tremor, or the codec's
LONGEST_HALF_US: Final = 500_000  # a slower rise or fall is the hand's own motion
LEAST_SHARE: Final = 0.1  # least energy out of a cycle over force times way: that of a force 7 degrees late
STEADY: Final = 0.9  # least ratio of a half to the one before the last: a swing that shrinks faster ends by itself


class _Turn(NamedTuple):
    """Where the force stopped rising or falling."""

    t_us: int
    size_n: float
    account_j: float  # energy put in so far, less what came back
    force_n: Vector
    position_m: Vector


class SwingWatch:
    """The account of one port, in joules since the start; call `add` in each tick."""

    def __init__(self) -> None:
        self.put_in_j = self.given_back_j = self.created_j = 0.0
        self._contact_j = self._lowest_j = 0.0  # of this contact
        self._force_n: Vector = ()
        self._position_m: Vector = ()
        self._way = 1  # the force rises, or falls (-1)
        self._newest = _Turn(0, 0.0, 0.0, (), ())  # the farthest on this way
        self._turns: deque[_Turn] = deque(maxlen=HALVES + 1)

    def add(self, now_us: int, force_n: Vector, position_m: Vector, law: WeberLaw) -> None:
        """Take in the force [N] that is applied from now on, and the position [m]."""
        if self._position_m:
            self._work(dot(self._force_n, minus(position_m, self._position_m)))
        self._force_n, self._position_m = force_n, position_m
        size_n = magnitude(force_n)
        if size_n <= law.floor_n:
            self._contact_j = self._lowest_j = 0.0
        here = _Turn(now_us, size_n, self.put_in_j - self.given_back_j, force_n, position_m)
        if self._way * (size_n - self._newest.size_n) >= 0.0:
            self._newest = here
        elif abs(size_n - self._newest.size_n) > SMALLEST_JND * law.jnd_n(max(size_n, self._newest.size_n)):
            self._turns.append(self._newest)
            self._way, self._newest = -self._way, here

    def _work(self, work_j: float) -> None:
        self.put_in_j += max(work_j, 0.0)
        self.given_back_j -= min(work_j, 0.0)
        self._contact_j += work_j
        if self._contact_j < self._lowest_j:
            self.created_j += self._lowest_j - self._contact_j
            self._lowest_j = self._contact_j

    def swings(self, now_us: int) -> bool:
        """Return whether the hand swings against the force, more and more or for ever."""
        turns = list(self._turns)
        if len(turns) <= HALVES or now_us - turns[-1].t_us > LONGEST_HALF_US:
            return False
        pairs = list(pairwise(turns))
        halves_n = [abs(after.size_n - before.size_n) for before, after in pairs]
        quick = all(after.t_us - before.t_us <= LONGEST_HALF_US for before, after in pairs)
        grows = all(after >= STEADY * before for before, after in zip(halves_n, halves_n[2:], strict=False))
        first, middle, last = turns[-3:]
        # What came out in a cycle, beyond what a true spring would give back between its two ends
        spring_j = 0.5 * dot(plus(first.force_n, last.force_n), minus(last.position_m, first.position_m))
        out_j = first.account_j + spring_j - last.account_j
        return quick and grows and out_j > LEAST_SHARE * halves_n[-1] * distance(last.position_m, middle.position_m)
