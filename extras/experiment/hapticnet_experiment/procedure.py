"""The measurement of a JND: series of pairs of forces, in which a staircase chooses each next difference.

In the method of limits, the pairs of a series differ more and more until the participant says "different". It depends
on step and criterion: with steps of 0.005 to 0.05 N the same finger gives Weber fractions of 0.025 to 0.18. So every
answer is stored, a step is a share of the reference, starts are random, and some series never change.

In the two-interval forced choice, the participant says which of two forces is stronger, so there is no criterion. Its
staircase is 1-up-2-down (H. Levitt, "Transformed up-down methods in psychoacoustics", 1971), which settles where 70.7 %
of the answers are right. The JND is the difference recognised in 75 %.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Final, TypeAlias

from hapticnet_experiment.plan import LimitsPlan
from hapticnet_experiment.schedule import Series

Z_75: Final = NormalDist().inv_cdf(0.75)  # standard deviations of the felt difference at 75 % right,
Z_70: Final = NormalDist().inv_cdf(math.sqrt(0.5))  # and at 70.7 %, where 1-up-2-down settles
FIRST_SHARE: Final = 0.25  # difference with which a staircase begins, as a share of the reference: several JNDs
SMALLEST_SHARE: Final = 0.002
FACTORS: Final = (2.0, 1.41, 1.19)  # between two differences before the first reversal, before the third, and after
REVERSALS: Final = 10  # number of reversals after which 1-up-2-down ends
AVERAGED: Final = 6  # number of last reversals that count


class Ascending:
    """A series of the method of limits: the JND is the smallest difference called different."""

    def __init__(self, plan: LimitsPlan, series: Series) -> None:
        self.done = False
        self._plan = plan
        self._series = series
        self._asked = 0
        self._jnd: float | None = None

    def share(self) -> float:
        """Return the next difference as a share of the reference."""
        return 0.0 if self._series.catch else self._series.start + self._asked * self._plan.step

    def answer(self, told: bool) -> None:
        """Process the answer: whether it was called different."""
        if told:
            self.done = True
            self._jnd = None if self._series.catch else self.share()
        self._asked += 1
        if self._series.pairs is not None:
            self.done |= self._asked >= self._series.pairs
        else:
            self.done |= self.share() > self._plan.largest

    def jnd(self) -> float | None:
        """Return the JND as a share of the reference; None if there is none."""
        return self._jnd


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
        """Whether it is finished."""
        return self._asked >= self.pairs or len(self._reversals) >= REVERSALS

    def share(self) -> float:
        """Return the next difference as a share of the reference."""
        return min(self._share, self.largest)

    def answer(self, right: bool) -> None:
        """Process the answer to it."""
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


Staircase: TypeAlias = Ascending | UpDown


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """The next pair: numbers of its series and of the pair within it, and its forces [N]."""

    series: int
    step: int
    reference_n: float
    difference_n: float  # comparison minus reference
    comparison_interval: int = 2  # interval of the comparison, 1 or 2
    catch: bool = False

    @property
    def forces_n(self) -> tuple[float, float]:
        """The forces [N] in order of presentation."""
        comparison_n = self.reference_n + self.difference_n
        return (self.reference_n, comparison_n) if self.comparison_interval == 2 else (comparison_n, self.reference_n)


class Procedure:
    """Asks the questions of all series, one after the other, continuing after earlier `answers`.

    For a forced choice, `intervals` has the interval of the comparison in each pair, ``plan.pairs`` for each series.
    """

    def __init__(
        self, plan: LimitsPlan, series: Sequence[Series], intervals: Sequence[int] = (), answers: Iterable[str] = ()
    ) -> None:
        self.thresholds: list[float | None] = []  # JND [N] of each finished series; None if none was found
        # Answered pairs of catch series, and those called different; None for a method without such series.
        self.catch_pairs = self.false_alarms = 0 if plan.method == "ascending" else None
        self._plan = plan
        self._series = series
        self._intervals = intervals
        self._step = 0
        self._staircase = self._begin()
        for answer in answers:
            self.answer(answer)

    def _begin(self) -> Staircase | None:
        plan, number = self._plan, len(self.thresholds)
        if number >= len(self._series):
            return None
        if plan.method == "ascending":
            return Ascending(plan, self._series[number])
        return UpDown(plan.largest, plan.pairs)

    def question(self) -> Question | None:
        """Return the next pair; None when all series are finished."""
        if self._staircase is None:
            return None
        plan, number, interval = self._plan, len(self.thresholds), 2
        if plan.method != "ascending":
            interval = self._intervals[(number * plan.pairs + self._step) % len(self._intervals)]
        series = self._series[number]
        return Question(
            series=number,
            step=self._step,
            reference_n=series.reference_n,
            difference_n=self._staircase.share() * series.reference_n,
            comparison_interval=interval,
            catch=series.catch,
        )

    def answer(self, answer: str) -> None:
        """Process the answer to the present question: "same" or "different", or the interval that felt stronger."""
        question, staircase = self.question(), self._staircase
        if question is None or staircase is None:
            return
        told = answer in ("different", str(question.comparison_interval))
        self._step += 1
        staircase.answer(told)
        if question.catch and self.catch_pairs is not None and self.false_alarms is not None:
            self.catch_pairs += 1
            self.false_alarms += told
        if staircase.done:
            share = staircase.jnd()
            self.thresholds.append(None if share is None else share * question.reference_n)
            self._step = 0
            self._staircase = self._begin()

    def by_reference(self) -> dict[float, list[float | None]]:
        """Return the JNDs [N] of each reference; None where no difference was large enough."""
        found: dict[float, list[float | None]] = {reference_n: [] for reference_n in self._plan.references_n}
        for series, threshold_n in zip(self._series, self.thresholds, strict=False):
            if not series.catch:
                found[series.reference_n].append(threshold_n)
        return found
