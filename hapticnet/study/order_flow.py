"""The session in which three tissues are ordered by stiffness."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any, Final

from hapticnet.perception import WeberLaw
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.plan import ConditionPlan, Plan, QuestionPlan, law_of
from hapticnet.study.rig import LIFTED, NO_MEASURES, Activity, Fault, Outcome, Play
from hapticnet.study.rows import OrderRow
from hapticnet.study.schedule import OrderSchedule, Trial
from hapticnet.study.screens import ScreenKind
from hapticnet.study.trial import Measures, Played, Stimulus

PRACTICE: Final = "practice"
"""What practice trials have in the column of the condition."""

TOUCHED: Final = 0.5
"""Share of its breach depth to which the needle must have pushed a tissue in before an answer is taken. The same depth
for each, so that a refused answer tells nothing about the stiffness."""

UNCOMPRESSED: Final = ConditionPlan(name=PRACTICE, codec="raw", multiplier=0.0)


class OrderFlow(Flow[OrderRow]):
    """The ordering task: practice, blocks of trials, ratings and breaks.

    Parameters
    ----------
    law
        The participant's law at 1 JND.
    rows, now_us, constants, questions
        As for `Flow`.
    """

    kind = OrderRow

    def __init__(
        self,
        plan: Plan,
        schedule: OrderSchedule,
        law: WeberLaw,
        rows: list[OrderRow],
        now_us: int,
        constants: dict[str, Any],
        questions: Sequence[QuestionPlan] = (),
    ) -> None:
        self.trial: Trial | None = None
        self._plan = plan
        self._schedule = schedule
        self._law = law
        self._typed = ""
        self._keys = ""
        self._answer_us: int | None = None
        self._rounds_shown = 0
        super().__init__(
            rows,
            now_us,
            constants | {"weber_fraction": law.weber_fraction, "floor_n": law.floor_n},
            plan=plan,
            questions=questions,
            instructions=plan.texts.instructions.order,
            most_attempts=plan.order.most_attempts,
        )

    @property
    def condition(self) -> ConditionPlan:
        """The condition of the present trial."""
        number = None if self.trial is None else self.trial.condition
        return UNCOMPRESSED if number is None else self._plan.condition[number]

    def _next(self, now_us: int) -> None:
        practice = self._pending_practice()
        if practice is not None:
            first = practice.index == practice.block * self._plan.order.practice
            if first and self._rounds_shown <= practice.block:
                self._rounds_shown = practice.block + 1
                self._show(self._screens.practice(practice.block), now_us)
            else:
                self._begin_trial(practice, now_us)
            return
        for block in range(self._schedule.blocks):
            trial = self._pending(block)
            if trial is not None:
                self._begin_trial(trial, now_us)
                return
            own = [row for row in self.rows if row.block == block]
            if self._rates and not any(row.event == "rating" for row in own):
                self._show(self._screens.rating(self._progress()), now_us)
                return
            breaks = sum(row.event == "break" for row in self.rows)
            if block + 1 < self._schedule.blocks and breaks <= block:
                self._show(
                    self._screens.pause(now_us + round(1e6 * self._plan.order.break_s), self._progress()), now_us
                )
                return
        self._emit("end", now_us)
        self._finish()

    @property
    def _rates(self) -> bool:
        return self._plan.order.rating and self._plan.order.arrangement == "blocked"

    def _progress(self) -> str:
        answered = sum(row.event == "trial" for row in self.rows)
        if self.trial is not None and self.trial.condition is None:
            return self._plan.texts.screens.practising
        return self._plan.texts.screens.trials.format(done=answered, all=len(self._schedule.trials))

    def _pending(self, block: int) -> Trial | None:
        """Return the next trial of a block: those that did not count come again at its end."""
        own = [row for row in self.rows if row.block == block]
        answered = {row.this_n for row in own if row.event == "trial"}
        pending = [trial for trial in self._schedule.trials if trial.block == block and trial.index not in answered]
        return min(pending, key=lambda trial: (_attempts(own, trial), trial.index), default=None)

    def _pending_practice(self) -> Trial | None:
        """Return the next practice trial; None once a round was good enough, or after the last round."""
        order = self._plan.order
        if not order.practice or any(row.block is not None for row in self.rows):
            return None
        answered = [row for row in self.rows if row.event == "practice"]
        rounds, within = divmod(len(answered), order.practice)
        if not within and rounds:
            last = answered[-order.practice :]
            if sum(row.pairs_correct or 0 for row in last) >= order.practice_pairs or rounds >= order.practice_rounds:
                return None
        return self._schedule.practice[len(answered)]

    def _begin_trial(self, trial: Trial, now_us: int) -> None:
        if not self._met:
            self._meet(now_us)
            return
        self.trial = trial
        self._typed = self._keys = ""
        self._answer_us = None
        self.deepest_m = None
        stimulus = self._stimulus(trial)
        self._emit("started", now_us, **self._values(trial, stimulus))
        self._show(self._screens.trial("", self._progress()), now_us, Play(stimulus))

    def _attempts_of(self, trial: Trial) -> int:
        """Return how often a trial was begun in this run and earlier ones."""
        practising = trial.condition is None
        own = [row for row in self.rows if (row.condition == PRACTICE) == practising]
        return _attempts(own, trial)

    def _stimulus(self, trial: Trial) -> Stimulus:
        condition, plan = self.condition, self._plan
        return Stimulus(
            number=trial.index,
            breach_forces_n=trial.breach_forces_n,
            gap_m=plan.order.gap_m,
            codec=condition.codec,
            law=law_of(condition, self._law.weber_fraction, self._law.floor_n),
            rate_hz=plan.link.rate_hz,
            forward=plan.link.forward,
            feedback=plan.link.feedback,
            seed=trial.seed + self._attempts_of(trial),  # another motion of a simulated hand when it comes again
            limit_s=plan.order.time_limit_s,
        )

    def _take_key(self, key: str, now_us: int) -> None:
        if self.screen.kind is ScreenKind.RATING:
            block = max(row.block for row in self.rows if row.event == "trial" and row.block is not None)
            condition = next(row.condition for row in reversed(self.rows) if row.event == "trial")
            self._emit(
                "rating", now_us, since_us=self._shown_us, block=block, condition=condition, rating=int(key), key=key,
                response_time_s=(now_us - self._shown_us) / 1e6,
            )  # fmt: skip
            self._go_on(now_us)
            return
        if self.screen.kind is not ScreenKind.TRIAL:
            return
        self._keys += {screens.BACKSPACE: "<", screens.ENTER: ""}.get(key, key)
        untouched = None
        if key == screens.ENTER:
            untouched = self._untouched()
            if untouched is None:
                self._answer_us = now_us
                self._conclude(halted=False)
                return
        else:
            self._typed = self._typed[:-1] if key == screens.BACKSPACE else self._typed + key
        self.screen = self._screens.trial(self._typed, self._progress(), untouched=untouched)

    def _untouched(self) -> int | None:
        """Return the first tissue that the needle was not pushed into, as far as that is known."""
        if self.deepest_m is None or not isinstance(self.activity, Play):
            return None
        for number, tissue in enumerate(self.activity.stimulus.tissues, start=1):
            if self.deepest_m < tissue.rest_position_m + TOUCHED * tissue.breach_depth_m:
                return number
        return None

    def _complete_activity(self, activity: Activity, outcome: Outcome, abort: str | None, now_us: int) -> None:
        trial = self.trial
        if trial is None or not isinstance(activity, Play):
            return
        reason, why = abort, self._why.stopped
        if reason is None and isinstance(outcome, Fault | Played):
            reason = outcome.reason if isinstance(outcome, Fault) else outcome.failure
            why = self._why.lifted if reason == LIFTED else self._why.fault
        if reason is None and self._answer_us is None:
            why = self._why.late
            reason = f"no answer within {self._plan.order.time_limit_s:g} s"
        measures = outcome.measures if isinstance(outcome, Played) else NO_MEASURES
        values = self._values(trial, activity.stimulus) | self._measured(measures)
        if reason is not None:
            self._emit("aborted", now_us, since_us=self._shown_us, reason=reason, **values)
            self._repeat(trial, reason, why, now_us)
            return
        values |= self._answer(trial, measures)
        undelivered = measures.undelivered(self._plan.order.least_delivered)
        if undelivered is not None:
            self._emit("repeated", now_us, since_us=self._shown_us, reason=undelivered, **values)
            why = self._why.undelivered if measures.touched_all else self._why.untouched
            self._repeat(trial, undelivered, why, now_us)
            return
        practising = trial.condition is None
        self._emit("practice" if practising else "trial", now_us, since_us=self._shown_us, **values)
        if practising:
            self._show(self._screens.feedback(self._typed, trial.order, now_us), now_us)
        else:
            self._go_on(now_us)

    def _repeat(self, trial: Trial, reason: str, why: str, now_us: int) -> None:
        self._met = False  # who knows where the finger is now?
        attempts = self._in_vain(trial.index)
        if attempts >= self._plan.order.most_attempts:
            self._stop(f"trial {trial.index} was begun {attempts} times in vain; the last time: {reason}")
        else:
            self._repeat_later(why, now_us)

    def _values(self, trial: Trial, stimulus: Stimulus) -> dict[str, Any]:
        """Return the columns of a trial that are known before it begins."""
        tissues = stimulus.tissues
        values: dict[str, Any] = {
            "this_n": trial.index,
            "this_rep_n": trial.repetition,
            "attempt": self._attempts_of(trial),
            "block": None if trial.condition is None else trial.block,
            "condition": self.condition.name,
            "codec": stimulus.codec,
            "multiplier": self.condition.threshold,
            "order_true": trial.order,
            "seed": stimulus.seed,
        }
        for number, tissue in enumerate(tissues, start=1):
            values[f"breach_force_{number}_n"] = tissue.breach_force_n
            values[f"stiffness_{number}_n_per_m"] = tissue.stiffness_n_per_m
        return values

    def _measured(self, measures: Measures) -> dict[str, Any]:
        """Return the columns of a trial that was played, answered or not."""
        values: dict[str, Any] = {
            "first_contact_s": measures.first_contact_s,
            "insertions": measures.insertions,
            "penetrations": measures.penetrations,
            "peak_speed_m_per_s": measures.peak_speed_m_per_s,
            "perceptual_error": measures.perceptual_error,
            "force_packets": measures.force_packets,
            "wire_bytes": measures.wire_bytes,
            "penetration_packets": measures.penetration_packets,
            "penetration_bytes": measures.penetration_bytes,
            "missed_ticks": measures.missed_ticks,
            "link_stale": measures.link_stale,
        }
        for number in range(1, len(measures.peaks_held_n) + 1):
            values[f"peak_held_{number}_n"] = measures.peaks_held_n[number - 1]
            values[f"peak_sensed_{number}_n"] = measures.peaks_sensed_n[number - 1]
        return values

    def _answer(self, trial: Trial, measures: Measures) -> dict[str, Any]:
        """Return the columns of the answer."""
        assert self._answer_us is not None  # noqa: S101 - for the type checker: there is an answer
        pairs = right_pairs(trial.order, self._typed)
        response_s = (self._answer_us - self._shown_us) / 1e6
        contact_s = measures.first_contact_s
        return {
            "order_answered": self._typed,
            "correct": int(self._typed == trial.order),
            "pairs_correct": pairs,
            "kendall": len(self._typed) * (len(self._typed) - 1) // 2 - pairs,
            "response_time_s": response_s,
            "contact_to_answer_s": None if contact_s is None else response_s - contact_s,
            "key": self._keys,
        }


def right_pairs(true: str, answered: str) -> int:
    """Return how many pairs of tissues are in the right order in an answer such as "213"."""
    return sum(answered.index(softer) < answered.index(harder) for softer, harder in combinations(true, 2))


def _attempts(rows: Sequence[OrderRow], trial: Trial) -> int:
    return sum(row.this_n == trial.index and row.event in ("aborted", "repeated") for row in rows)
