"""The ascending method of limits: series of pairs that differ more and more, until the participant says "different".

Its result depends on step and criterion: with steps of 0.005 to 0.05 N the same finger gives Weber fractions of 0.025
to 0.18. So every answer is stored, a step is a share of the reference, starts are random, and some series never change.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticnet.study.plan import LimitsPlan

LONGEST_CATCH: Final = 10
"""Largest number of pairs in a catch series; the smallest is 3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """One series of pairs.

    Attributes
    ----------
    reference_n
        Reference force [N].
    start
        Difference of the first pair, as a share of the reference.
    pairs
        Number of pairs of a catch series; None for a series that ascends.
    """

    reference_n: float
    start: float
    pairs: int | None = None

    @property
    def catch(self) -> bool:
        """Whether nothing changes in this series."""
        return self.pairs is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """The next pair.

    Attributes
    ----------
    series, step
        Number of the series, and of the pair within it.
    reference_n, difference_n
        Reference force, and comparison minus reference [N].
    comparison_interval
        Interval of the comparison, 1 or 2.
    """

    series: int
    step: int
    reference_n: float
    difference_n: float
    comparison_interval: int = 2
    catch: bool = False

    @property
    def forces_n(self) -> tuple[float, float]:
        """The forces [N] in the order in which they come."""
        comparison_n = self.reference_n + self.difference_n
        return (self.reference_n, comparison_n) if self.comparison_interval == 2 else (comparison_n, self.reference_n)


def draw_series(plan: LimitsPlan, number: int, rng: np.random.Generator) -> tuple[Series, ...]:
    """Return the series of a session.

    The references come in a Latin square by repetition and participant `number`; catch series stand at random places.
    """
    references, drawn = plan.references_n, []
    for repetition in range(plan.repetitions):
        shift = number - 1 + repetition
        rotated = [references[(place + shift) % len(references)] for place in range(len(references))]
        turned = rotated if (number - 1 + repetition // len(references)) % 2 == 0 else rotated[::-1]
        drawn += [Series(reference_n=each, start=_start(plan, rng)) for each in turned]
    for index in range(round(plan.catch * len(drawn))):
        reference_n = references[(index + number) % len(references)]
        pairs = int(rng.integers(3, LONGEST_CATCH + 1))
        drawn.insert(int(rng.integers(len(drawn) + 1)), Series(reference_n=reference_n, start=0.0, pairs=pairs))
    return tuple(drawn)


def _start(plan: LimitsPlan, rng: np.random.Generator) -> float:
    """Return a random start, on a grid of a tenth of a step."""
    return round(float(rng.uniform(0.0, plan.start)) / (0.1 * plan.step)) * 0.1 * plan.step


class Ascending:
    """Ask the questions of all series, one after the other.

    Attributes
    ----------
    thresholds
        For each series that is over: the smallest difference [N] called different; None if none was, or in a catch
        series.
    catch_pairs, false_alarms
        Pairs of catch series that were answered, and those of them that were called different.
    """

    def __init__(self, plan: LimitsPlan, series: Sequence[Series]) -> None:
        self._plan = plan
        self._series = series
        self._step = 0
        self.thresholds: list[float | None] = []
        self.catch_pairs = 0
        self.false_alarms = 0

    def question(self) -> Question | None:
        """Return the next pair; None when all series are over."""
        number = len(self.thresholds)
        if number >= len(self._series):
            return None
        series = self._series[number]
        share = 0.0 if series.catch else series.start + self._step * self._plan.step
        return Question(
            series=number,
            step=self._step,
            reference_n=series.reference_n,
            difference_n=share * series.reference_n,
            catch=series.catch,
        )

    def answer(self, answer: str) -> None:
        """Take the answer to the present question, "same" or "different"."""
        question = self.question()
        if question is None:
            return
        series = self._series[question.series]
        self._step += 1
        self.catch_pairs += series.catch
        if answer == "different":
            self.false_alarms += series.catch
            self._end(None if series.catch else question.difference_n)
        elif series.pairs is not None:
            if self._step >= series.pairs:
                self._end(None)
        elif series.start + self._step * self._plan.step > self._plan.largest:
            self._end(None)

    def _end(self, threshold_n: float | None) -> None:
        self.thresholds.append(threshold_n)
        self._step = 0

    def by_reference(self) -> dict[float, list[float | None]]:
        """Return the thresholds [N] of each reference; None where no difference was large enough."""
        found: dict[float, list[float | None]] = {reference_n: [] for reference_n in self._plan.references_n}
        for series, threshold_n in zip(self._series, self.thresholds, strict=False):
            if not series.catch:
                found[series.reference_n].append(threshold_n)
        return found
