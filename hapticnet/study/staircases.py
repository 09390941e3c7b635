"""The staircases of a forced choice, which choose the next difference after each answer.

There are two: 1-up-2-down (H. Levitt, "Transformed up-down methods in psychoacoustics", 1971),
which settles where 70.7 % of the answers are right, and a Bayesian one after Watson and Pelli ("QUEST", 1983), which
asks where the answer tells most about the threshold. Both give the JND as the difference told right in 75 %.
"""

import math
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray

Z_75: Final = NormalDist().inv_cdf(0.75)
Z_70: Final = NormalDist().inv_cdf(math.sqrt(0.5))
"""Standard deviations of the felt difference at 75 % right, and at 70.7 %, where 1-up-2-down settles."""

LAPSE: Final = 0.02
"""Share of answers that are given without regard to the stimulus; half of them are right. An assumption."""

FIRST_SHARE: Final = 0.25
"""Difference with which a staircase begins, as a share of the reference: several JNDs."""

SMALLEST_SHARE: Final = 0.002
FACTORS: Final = (2.0, 1.41, 1.19)
"""Factor between two differences before the first reversal, before the third, and after."""

REVERSALS: Final = 10
AVERAGED: Final = 6
"""Reversals after which 1-up-2-down ends, and how many of the last are averaged."""

GRID: Final = 121


@dataclass(slots=True)
class UpDown:
    """1-up-2-down on a logarithmic scale: smaller after two right answers, larger after a wrong one."""

    largest: float
    pairs: int
    _share: float = FIRST_SHARE
    _right: int = 0
    _asked: int = 0
    _direction: int = 0
    _reversals: list[float] = field(default_factory=list)

    @property
    def done(self) -> bool:
        """Whether it has asked enough."""
        return self._asked >= self.pairs or len(self._reversals) >= REVERSALS

    def share(self) -> float:
        """Return the next difference as a share of the reference."""
        return min(self._share, self.largest)

    def answer(self, right: bool) -> None:
        """Take the answer to it."""
        self._asked += 1
        if right and self._right == 0:
            self._right = 1
            return
        self._right = 0
        direction = -1 if right else 1
        if self._direction == -direction:
            self._reversals.append(self.share())
        self._direction = direction
        factor = FACTORS[min((len(self._reversals) + 1) // 2, len(FACTORS) - 1)]
        self._share = min(max(self.share() * factor**direction, SMALLEST_SHARE), self.largest)

    def jnd(self) -> float | None:
        """Return the JND as a share of the reference."""
        last = self._reversals[-AVERAGED:]
        if len(last) < 4:
            return None
        settled = math.exp(sum(map(math.log, last)) / len(last))
        jnd = settled * Z_75 / Z_70
        return jnd if jnd < self.largest else None


class Bayesian:
    """A posterior over the JND; each difference is the one whose answer is expected to narrow it most."""

    def __init__(self, largest: float, pairs: int) -> None:
        self._largest = largest
        self._pairs = pairs
        self._asked = 0
        self._jnds: FloatArray = np.geomspace(SMALLEST_SHARE, 2.0 * largest, GRID)
        self._log_posterior: FloatArray = np.zeros(GRID)
        self._shares: FloatArray = np.geomspace(SMALLEST_SHARE, largest, 40)
        self._right: FloatArray = _share_right(self._shares[:, np.newaxis], self._jnds)

    @property
    def done(self) -> bool:
        """Whether it has asked enough."""
        return self._asked >= self._pairs

    def share(self) -> float:
        """Return the next difference as a share of the reference."""
        posterior = self._posterior()
        right = self._right @ posterior
        # Information that the answer gives: entropy of the answer less its mean entropy at a known JND.
        gained = _entropy(right) - _entropy(self._right) @ posterior
        return float(self._shares[int(gained.argmax())])

    def answer(self, right: bool) -> None:
        """Take the answer to it."""
        chances = self._right[int(np.abs(self._shares - self.share()).argmin())]
        self._asked += 1
        self._log_posterior += np.log(chances if right else 1.0 - chances)

    def jnd(self) -> float | None:
        """Return the JND as a share of the reference: the mean of the posterior of its logarithm."""
        if not self._asked:
            return None
        jnd = math.exp(float(self._posterior() @ np.log(self._jnds)))
        return jnd if jnd < self._largest else None

    def _posterior(self) -> FloatArray:
        weights = np.exp(self._log_posterior - self._log_posterior.max())
        posterior: FloatArray = weights / weights.sum()
        return posterior


def _share_right(shares: FloatArray, jnds: FloatArray) -> FloatArray:
    """Return the share of right answers at differences, for JNDs: a cumulative normal through 75 % at the JND."""
    normal = np.vectorize(NormalDist().cdf, otypes=[np.float64])
    right: FloatArray = 0.5 * LAPSE + (1.0 - LAPSE) * normal(Z_75 * shares / jnds)
    return right


def _entropy(share: FloatArray) -> FloatArray:
    entropy: FloatArray = -share * np.log(share) - (1.0 - share) * np.log1p(-share)
    return entropy
