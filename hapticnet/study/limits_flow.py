"""The session in which the JND is measured."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hapticnet.checks import check_integer
from hapticnet.errors import FileError
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.forced_choice import ForcedChoice
from hapticnet.study.limits import Ascending, Question, Series, draw_series
from hapticnet.study.plan import Plan, QuestionPlan
from hapticnet.study.rig import Activity, Fault, Outcome, Present
from hapticnet.study.rows import LimitsRow
from hapticnet.study.schedule import LARGEST_SEED, participant_number
from hapticnet.study.screens import ScreenKind
from hapticnet.study.stimulus import Pair, Presented

PARTS = 3
"""Parts of a session, with a break between two of them."""

ANSWERS = {screens.SAME: "same", screens.DIFFERENT: "different", "1": "1", "2": "2"}


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsSchedule:
    """Everything random of a measurement: the series, and the interval of the comparison in each pair."""

    participant: str
    session: int
    seed: int
    plan: str
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

    def to_json(self) -> str:
        """Return the schedule as text."""
        return json.dumps(asdict(self), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str, source: str) -> "LimitsSchedule":
        """Return the schedule in a text; raise FileError if it is none."""
        try:
            content: dict[str, Any] = json.loads(text)
            content["series"] = tuple(Series(**each) for each in content["series"])
            content["intervals"] = tuple(content["intervals"])
            return cls(**content)
        except (ValueError, TypeError, KeyError) as error:
            raise FileError(f"{source}: not a schedule: {error}") from error


def draw_limits(plan: Plan, participant: str, session: int, seed: int) -> LimitsSchedule:
    """Return the schedule of a measurement.

    Raises
    ------
    SettingsError
        If participant or session is not a number, or the seed is negative.
    """
    number = participant_number(participant)
    check_integer("session", session, 1, 1000)
    check_integer("seed", seed, 0, LARGEST_SEED)
    rng = np.random.default_rng([seed, number, session, 2])
    limits = plan.limits
    series = draw_series(limits, number, rng)
    if limits.method != "ascending":
        series = tuple(Series(reference_n=each.reference_n, start=0.0) for each in series if not each.catch)
    intervals = rng.integers(1, 3, limits.pairs * len(series)).tolist()
    return LimitsSchedule(
        participant=participant,
        session=session,
        seed=seed,
        plan=plan.digest(),
        series=series,
        intervals=tuple(intervals),
    )


def procedure_of(plan: Plan, schedule: LimitsSchedule, rows: list[LimitsRow]) -> Ascending | ForcedChoice:
    """Return the procedure after the answers in `rows`."""
    procedure: Ascending | ForcedChoice
    if plan.limits.method == "ascending":
        procedure = Ascending(plan.limits, schedule.series)
    else:
        references_n = [each.reference_n for each in schedule.series]
        procedure = ForcedChoice(plan.limits, references_n, schedule.intervals)
    for row in rows:
        if row.event == "trial" and row.answer is not None:
            procedure.answer(row.answer)
    return procedure


class LimitsFlow(Flow[LimitsRow]):
    """The measurement of the JND: pairs of forces, each with a question."""

    kind = LimitsRow

    def __init__(
        self,
        plan: Plan,
        schedule: LimitsSchedule,
        rows: list[LimitsRow],
        now_us: int,
        constants: dict[str, Any],
        questions: Sequence[QuestionPlan] = (),
    ) -> None:
        self.procedure = procedure_of(plan, schedule, rows)
        self._plan = plan.limits
        self._texts = plan.texts
        self._series = len(schedule.series)
        self._question: Question | None = None
        self._presented: Presented | None = None
        self._presented_us = now_us
        instructions = plan.texts.instructions
        super().__init__(
            rows,
            now_us,
            constants,
            plan=plan,
            questions=questions,
            instructions=instructions.ascending if self._plan.method == "ascending" else instructions.choice,
            most_attempts=self._plan.most_attempts,
        )

    @property
    def presented(self) -> Presented | None:
        """The pair that is asked about; None if no question is open."""
        return self._presented

    def _next(self, now_us: int) -> None:
        question = self.procedure.question()
        if question is None:
            self._emit("end", now_us)
            self._finish()
        elif not self._met:
            self._meet(now_us)
        elif question.step == 0 and self._break_is_due(question.series):
            self._show(self._screens.pause(now_us + round(1e6 * self._plan.break_s), self._progress()), now_us)
        else:
            self._question = question
            pair = Pair(
                forces_n=question.forces_n,
                stimulus_us=round(1e6 * self._plan.stimulus_s),
                gap_us=round(1e6 * self._plan.gap_s),
            )
            self._emit("started", now_us, **self._values(question, None))
            self._show(self._screens.stimuli(self._progress()), now_us, Present(pair))

    def _break_is_due(self, series: int) -> bool:
        breaks = sum(row.event == "break" for row in self.rows)
        return breaks < PARTS - 1 and series >= (breaks + 1) * self._series / PARTS

    def _progress(self) -> str:
        return self._texts.screens.series.format(done=len(self.procedure.thresholds), all=self._series)

    def _take_key(self, key: str, now_us: int) -> None:
        if self.screen.kind is not ScreenKind.QUESTION or self._question is None:
            return
        answer, question = ANSWERS[key], self._question
        right = None
        if self._plan.method != "ascending":
            right = int(answer == str(question.comparison_interval))
        values = self._values(question, self._presented) | {
            "answer": answer,
            "correct": right,
            "key": key,
            "response_time_s": (now_us - self._presented_us) / 1e6,
        }
        self._emit("trial", now_us, since_us=self._shown_us, **values)
        self.procedure.answer(answer)
        self._presented = None
        self._go_on(now_us)

    def _complete_activity(self, activity: Activity, outcome: Outcome, abort: str | None, now_us: int) -> None:
        question = self._question
        if question is None or not isinstance(activity, Present):
            return
        reason, event, why = abort, "aborted", self._why.stopped
        if reason is None and isinstance(outcome, Fault):
            reason, why = outcome.reason, self._why.fault
        presented = outcome if isinstance(outcome, Presented) else None
        if reason is None and presented is not None:
            reason, event, why = presented.missed(self._plan.tolerance), "repeated", self._why.undelivered
        if reason is None and presented is not None:
            shown_us = self._shown_us
            method = self._plan.method
            ask = self._screens.same_or_different if method == "ascending" else self._screens.which_stronger
            self._presented, self._presented_us = presented, now_us
            self._show(ask(self._progress()), now_us)
            self._shown_us = shown_us  # the row begins with the stimuli
            return
        self._emit(
            "repeated" if event == "repeated" else "aborted",
            now_us,
            since_us=self._shown_us,
            reason=reason,
            **self._values(question, presented),
        )
        self._met = False  # who knows where the finger is now?
        vain = self._in_vain(self._number())
        if vain >= self._plan.most_attempts:
            self._stop(f"a pair was presented {vain} times in vain; the last time: {reason}")
        else:
            self._repeat_later(why, now_us)

    def _number(self) -> int:
        """Return the number of the present pair: that of the answers before it."""
        return sum(row.event == "trial" for row in self.rows)

    def _values(self, question: Question, presented: Presented | None) -> dict[str, Any]:
        """Return the columns of a pair, answered or not."""
        number = self._number()
        fails = sum(row.this_n == number and row.event in ("aborted", "repeated") for row in self.rows)
        held_n = question.forces_n
        sensed_n = (None, None) if presented is None else presented.sensed_n
        return {
            "this_n": number,
            "attempt": fails,
            "method": self._plan.method,
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


def device_errors_n(rows: list[LimitsRow]) -> dict[float, list[float]]:
    """Return sensed less held force [N] of every stimulus that was answered, by reference."""
    found: dict[float, list[float]] = {}
    for row in rows:
        if row.event != "trial" or row.reference_n is None:
            continue
        for held_n, sensed_n in ((row.held_1_n, row.sensed_1_n), (row.held_2_n, row.sensed_2_n)):
            if held_n is not None and sensed_n is not None:
                found.setdefault(row.reference_n, []).append(sensed_n - held_n)
    return found
