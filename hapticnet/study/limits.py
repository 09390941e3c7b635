"""The measurement of the JND: the ascending method of limits or a forced choice, its schedule, and its session.

In the method of limits, series of pairs differ more and more until the participant says "different". The result depends
on step and criterion: with steps of 0.005 to 0.05 N the same finger gives Weber fractions of 0.025 to 0.18. So every
answer is stored, a step is a share of the reference, starts are random, and some series never change.

In the two-interval forced choice, the participant says which of two forces is stronger. There is no criterion, unlike
"same" or "different". A staircase for each reference chooses the differences (`staircases`).
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.plan import LimitsPlan, Plan, QuestionPlan
from hapticnet.study.rig import Activity, Fault, Outcome, Pair, Present, Presented
from hapticnet.study.rows import LimitsRow
from hapticnet.study.schedule import Schedule, generator, participant_number
from hapticnet.study.screens import ScreenKind
from hapticnet.study.staircases import Bayesian, UpDown

LONGEST_CATCH: Final = 10
"""Largest number of pairs in a catch series; the smallest is 3."""

PARTS: Final = 3
"""Parts of a session, with a break between two of them."""

ANSWERS: Final = {screens.SAME: "same", screens.DIFFERENT: "different", "1": "1", "2": "2"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """One series of pairs, or one staircase."""

    reference_n: float
    start: float  # difference of the first pair, as a share of the reference
    pairs: int | None = None  # number of pairs of a catch series; None for any other

    @property
    def catch(self) -> bool:
        """Whether nothing changes in this series."""
        return self.pairs is not None


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
        """The forces [N] in the order in which they come."""
        comparison_n = self.reference_n + self.difference_n
        return (self.reference_n, comparison_n) if self.comparison_interval == 2 else (comparison_n, self.reference_n)


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsSchedule(Schedule):
    """Everything random of a measurement: the series, and the interval of the comparison in each pair."""

    series: tuple[Series, ...]
    intervals: tuple[int, ...]

    def lines(self, plan: Plan) -> list[str]:
        """Return the schedule for a person: a line for each series."""
        method = plan.limits.method
        told = [f"participant {self.participant}, session {self.session}: {method}, seed {self.seed}"]
        for number, each in enumerate(self.series, start=1):
            begin = f"from {100 * each.start:.2g} %, {100 * plan.limits.step:g} % a step"
            if each.pairs is not None:
                begin = f"{each.pairs} pairs of equal forces"
            elif method != "ascending":
                begin = f"at most {plan.limits.pairs} pairs"
            told.append(f"  series {number}: {each.reference_n:g} N, {begin}")
        return told

    @classmethod
    def _restored(cls, content: dict[str, Any]) -> dict[str, Any]:
        series = tuple(Series(**each) for each in content["series"])
        return content | {"series": series, "intervals": tuple(content["intervals"])}


def draw_limits(plan: Plan, participant: str, session: int, seed: int) -> LimitsSchedule:
    """Return the schedule of a measurement.

    The references come in a Latin square by repetition and participant; catch series stand at random places.

    Raises
    ------
    SettingsError
        If participant or session is not a number, or the seed is negative.
    """
    rng, number = generator(participant, session, seed, 2), participant_number(participant)
    limits, references = plan.limits, plan.limits.references_n
    series: list[Series] = []
    for repetition in range(limits.repetitions):
        shift = number - 1 + repetition
        rotated = [references[(place + shift) % len(references)] for place in range(len(references))]
        turned = rotated if (number - 1 + repetition // len(references)) % 2 == 0 else rotated[::-1]
        series += [Series(reference_n=each, start=_start(limits, rng)) for each in turned]
    for index in range(round(limits.catch * len(series))):
        reference_n = references[(index + number) % len(references)]
        pairs = int(rng.integers(3, LONGEST_CATCH + 1))
        series.insert(int(rng.integers(len(series) + 1)), Series(reference_n=reference_n, start=0.0, pairs=pairs))
    if limits.method != "ascending":
        series = [replace(each, start=0.0) for each in series if not each.catch]
    return LimitsSchedule(
        participant=participant,
        session=session,
        seed=seed,
        plan=plan.digest(),
        series=tuple(series),
        intervals=tuple(rng.integers(1, 3, limits.pairs * len(series)).tolist()),
    )


def _start(plan: LimitsPlan, rng: np.random.Generator) -> float:
    """Return a random start, on a grid of a tenth of a step."""
    return round(float(rng.uniform(0.0, plan.start)) / (0.1 * plan.step)) * 0.1 * plan.step


class Procedure(ABC):
    """Asks the questions of all series, one after the other.

    Attributes
    ----------
    thresholds
        For each series that is over: the JND [N]; None if none was found, or in a catch series.
    catch_pairs, false_alarms
        Pairs of catch series that were answered, and those of them that were called different; None for a method
        without catch series.
    """

    def __init__(self, plan: LimitsPlan, series: Sequence[Series]) -> None:
        self.thresholds: list[float | None] = []
        self.catch_pairs: int | None = None
        self.false_alarms: int | None = None
        self._plan = plan
        self._series = series
        self._step = 0

    def question(self) -> Question | None:
        """Return the next pair; None when all series are over."""
        number = len(self.thresholds)
        return None if number >= len(self._series) else self._ask(number, self._series[number])

    def answer(self, answer: str) -> None:
        """Take the answer to the present question: "same" or "different", or the interval that felt stronger."""
        question = self.question()
        if question is not None:
            self._step += 1
            self._take(answer, question, self._series[question.series])

    def by_reference(self) -> dict[float, list[float | None]]:
        """Return the JNDs [N] of each reference; None where no difference was large enough."""
        found: dict[float, list[float | None]] = {reference_n: [] for reference_n in self._plan.references_n}
        for series, threshold_n in zip(self._series, self.thresholds, strict=False):
            if not series.catch:
                found[series.reference_n].append(threshold_n)
        return found

    def _end(self, threshold_n: float | None) -> None:
        self.thresholds.append(threshold_n)
        self._step = 0

    @abstractmethod
    def _ask(self, number: int, series: Series) -> Question:
        """Return the present pair of a series."""

    @abstractmethod
    def _take(self, answer: str, question: Question, series: Series) -> None:
        """Take the answer to a question, and end the series if it is over."""


class Ascending(Procedure):
    """The method of limits: a JND is the smallest difference called different."""

    def __init__(self, plan: LimitsPlan, series: Sequence[Series]) -> None:
        super().__init__(plan, series)
        self.catch_pairs = self.false_alarms = 0

    def _ask(self, number: int, series: Series) -> Question:
        share = 0.0 if series.catch else series.start + self._step * self._plan.step
        return Question(
            series=number,
            step=self._step,
            reference_n=series.reference_n,
            difference_n=share * series.reference_n,
            catch=series.catch,
        )

    def _take(self, answer: str, question: Question, series: Series) -> None:
        self.catch_pairs = (self.catch_pairs or 0) + series.catch
        if answer == "different":
            self.false_alarms = (self.false_alarms or 0) + series.catch
            self._end(None if series.catch else question.difference_n)
        elif series.pairs is not None:
            if self._step >= series.pairs:
                self._end(None)
        elif series.start + self._step * self._plan.step > self._plan.largest:
            self._end(None)


class ForcedChoice(Procedure):
    """One staircase after the other.

    Parameters
    ----------
    intervals
        Interval of the comparison, 1 or 2, for each pair: at least ``plan.pairs`` for each staircase.
    """

    def __init__(self, plan: LimitsPlan, series: Sequence[Series], intervals: Sequence[int]) -> None:
        super().__init__(plan, series)
        self._intervals = intervals
        self._staircase = self._new()

    def _new(self) -> UpDown | Bayesian:
        kind = UpDown if self._plan.method == "up-down" else Bayesian
        return kind(self._plan.largest, self._plan.pairs)

    def _ask(self, number: int, series: Series) -> Question:
        return Question(
            series=number,
            step=self._step,
            reference_n=series.reference_n,
            difference_n=self._staircase.share() * series.reference_n,
            comparison_interval=self._intervals[(number * self._plan.pairs + self._step) % len(self._intervals)],
        )

    def _take(self, answer: str, question: Question, series: Series) -> None:
        self._staircase.answer(answer == str(question.comparison_interval))
        if self._staircase.done:
            share = self._staircase.jnd()
            self._end(None if share is None else share * series.reference_n)
            self._staircase = self._new()


def procedure_of(plan: Plan, schedule: LimitsSchedule, rows: Sequence[LimitsRow]) -> Procedure:
    """Return the procedure after the answers in `rows`."""
    procedure: Procedure
    if plan.limits.method == "ascending":
        procedure = Ascending(plan.limits, schedule.series)
    else:
        procedure = ForcedChoice(plan.limits, schedule.series, schedule.intervals)
    for row in rows:
        if row.event == "trial" and row.answer is not None:
            procedure.answer(row.answer)
    return procedure


class LimitsFlow(Flow[LimitsRow]):
    """The measurement of the JND: pairs of forces, each with a question. Parameters are as for `Flow`.

    Attributes
    ----------
    presented
        The pair that is asked about; None if no question is open.
    """

    kind = LimitsRow

    def __init__(
        self,
        plan: Plan,
        schedule: LimitsSchedule,
        rows: Sequence[LimitsRow],
        now_us: int,
        constants: dict[str, Any],
        questions: Sequence[QuestionPlan] = (),
    ) -> None:
        self.procedure = procedure_of(plan, schedule, rows)
        self.presented: Presented | None = None
        self._limits = plan.limits
        self._series = len(schedule.series)
        self._question: Question | None = None
        self._presented_us = now_us
        instructions = plan.texts.instructions["ascending" if plan.limits.method == "ascending" else "choice"]
        super().__init__(plan, plan.limits, rows, now_us, constants, questions, instructions)

    def _next(self, now_us: int) -> None:
        question = self.procedure.question()
        if question is None:
            self._emit("end", now_us)
            self._finish()
        elif not self._met:
            self._meet(now_us)
        elif question.step == 0 and self._break_is_due(question.series):
            self._pause(now_us)
        else:
            self._question = question
            pair = Pair(
                forces_n=question.forces_n,
                stimulus_us=round(1e6 * self._limits.stimulus_s),
                gap_us=round(1e6 * self._limits.gap_s),
            )
            self._emit("started", now_us, **self._values(question, None))
            self._show(self._screens.stimuli(self._progress()), now_us, Present(pair))

    def _break_is_due(self, series: int) -> bool:
        return self._breaks < PARTS - 1 and series >= (self._breaks + 1) * self._series / PARTS

    def _progress(self) -> str:
        return self._plan.texts.screens["series"].format(done=len(self.procedure.thresholds), all=self._series)

    def _take_key(self, key: str, now_us: int) -> None:
        if self.screen.kind is not ScreenKind.QUESTION or self._question is None:
            return
        answer, question, right = ANSWERS[key], self._question, None
        if self._limits.method != "ascending":
            right = int(answer == str(question.comparison_interval))
        values = self._values(question, self.presented) | {
            "answer": answer,
            "correct": right,
            "key": key,
            "response_time_s": (now_us - self._presented_us) / 1e6,
        }
        self._emit("trial", now_us, since_us=self._shown_us, **values)
        self.procedure.answer(answer)
        self.presented = None
        self._go_on(now_us)

    def _complete_activity(self, activity: Activity, outcome: Outcome, abort: str | None, now_us: int) -> None:
        question = self._question
        if question is None or not isinstance(activity, Present):
            return
        presented = outcome if isinstance(outcome, Presented) else None
        values = self._values(question, presented)
        if abort is None and presented is not None:
            missed = presented.missed(self._limits.tolerance)
            if missed is None:
                shown_us, ascends = self._shown_us, self._limits.method == "ascending"
                ask = self._screens.same_or_different if ascends else self._screens.which_stronger
                self.presented, self._presented_us = presented, now_us
                self._show(ask(self._progress()), now_us)
                self._shown_us = shown_us  # the row begins with the stimuli
                return
            reason, why = missed, "undelivered"
            self._emit("repeated", now_us, since_us=self._shown_us, reason=reason, **values)
        else:
            fault = outcome.reason if isinstance(outcome, Fault) else "nothing was presented"
            reason, why = (abort, "stopped") if abort is not None else (fault, "fault")
            self._emit("aborted", now_us, since_us=self._shown_us, reason=reason, **values)
        self._repeat(self._number(), "a pair was presented", reason, why, now_us)

    def _number(self) -> int:
        """Return the number of the present pair: that of the answers before it."""
        return sum(row.event == "trial" for row in self.rows)

    def _values(self, question: Question, presented: Presented | None) -> dict[str, Any]:
        """Return the columns of a pair, answered or not."""
        number = self._number()
        held_n = question.forces_n
        sensed_n = (None, None) if presented is None else presented.sensed_n
        return {
            "this_n": number,
            "attempt": self._attempts(number, self.rows),
            "method": self._limits.method,
            "series": question.series,
            "step": question.step,
            "catch": int(question.catch),
            "reference_n": question.reference_n,
            "difference_n": question.difference_n,
            "comparison_interval": question.comparison_interval,
            "held_1_n": held_n[0],
            "held_2_n": held_n[1],
            "sensed_1_n": sensed_n[0],
            "sensed_2_n": sensed_n[1],
        }


def device_errors_n(rows: Sequence[LimitsRow]) -> dict[float, list[float]]:
    """Return sensed less held force [N] of every stimulus that was answered, by reference."""
    found: dict[float, list[float]] = {}
    for row in rows:
        if row.event != "trial" or row.reference_n is None:
            continue
        for held_n, sensed_n in ((row.held_1_n, row.sensed_1_n), (row.held_2_n, row.sensed_2_n)):
            if held_n is not None and sensed_n is not None:
                found.setdefault(row.reference_n, []).append(sensed_n - held_n)
    return found
