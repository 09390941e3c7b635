"""The two tasks of a study as flows: order three tissues by stiffness, and measure the JND pair by pair."""

from collections.abc import Sequence
from dataclasses import asdict
from itertools import combinations
from typing import Any, Final

from hapticnet.perception import WeberLaw
from hapticnet_experiment import screens
from hapticnet_experiment.flow import Flow
from hapticnet_experiment.plan import ConditionPlan
from hapticnet_experiment.procedure import Procedure, Question
from hapticnet_experiment.rig import Outcome, Pair, Presented
from hapticnet_experiment.rows import Event, LimitsRow, OrderRow
from hapticnet_experiment.schedule import LimitsSchedule, OrderSchedule, OrderTrial
from hapticnet_experiment.screens import ScreenKind
from hapticnet_experiment.trial import NO_MEASURES, Measures, Played, Stimulus, stimulus_of

ORDER: Final = "order"
LIMITS: Final = "limits"
PRACTICE: Final = "practice"  # value of practice trials in the column of the condition
# Share of its breach depth to which the needle must push a tissue in before an answer is accepted. The same depth
# for each, so that a refused answer reveals nothing about the stiffness.
TOUCHED: Final = 0.5
UNCOMPRESSED: Final = ConditionPlan(name=PRACTICE, codec="raw", multiplier=0.0)
PARTS: Final = 3  # parts of a measurement of the JND, with a break between two of them
ANSWERS: Final = {screens.SAME: "same", screens.DIFFERENT: "different", "1": "1", "2": "2"}


class OrderFlow(Flow[OrderRow]):
    """The ordering task: practice, blocks of trials, ratings and breaks."""

    kind = OrderRow
    schedule_kind = OrderSchedule
    item = "trial"
    _schedule: OrderSchedule
    _instructions = "order"

    def _prepare(self) -> None:
        self.trial: OrderTrial | None = None
        self._part = self._order = self._plan.order
        law = {name: self._constants[name] for name in ("weber_fraction", "floor_n")}
        self._law = WeberLaw(**law)  # the participant's at 1 JND
        self._stimulus: Stimulus | None = None
        self._typed = ""
        self._keys = ""
        self._answer_us: int | None = None
        self._rounds_shown = 0

    @property
    def condition(self) -> ConditionPlan:
        """The condition of the present trial."""
        number = None if self.trial is None else self.trial.condition
        return UNCOMPRESSED if number is None else self._plan.condition[number]

    def _next(self, now_us: int) -> None:
        practice = self._pending_practice()
        if practice is not None:
            first = practice.index == practice.block * self._order.practice
            if first and self._rounds_shown <= practice.block:
                self._rounds_shown = practice.block + 1
                text = self._plan.texts.screens["practice_again" if practice.block else "practice_text"]
                screen = self._screens.make(ScreenKind.PRACTICE, "practice", "go_on", "end", text=text)
                self._show(screen, now_us)
            else:
                self._begin_trial(practice, now_us)
            return
        for block in range(self._schedule.blocks):
            trial = self._pending(block)
            if trial is not None:
                self._begin_trial(trial, now_us)
                return
            if self._order.rating and not any(row.event == "rating" and row.block == block for row in self.rows):
                self._show(self._screens.rating(self._progress()), now_us)
                return
            if block + 1 < self._schedule.blocks and self._breaks <= block:
                self._pause(now_us)
                return
        self._emit("end", now_us)
        self._finish()

    def _progress(self) -> str:
        words = self._plan.texts.screens
        if self.trial is not None and self.trial.condition is None:
            return words["practising"]
        answered = sum(row.event == "trial" for row in self.rows)
        return words["trials"].format(done=answered, all=len(self._schedule.trials))

    def _pending(self, block: int) -> OrderTrial | None:
        """Return the next trial of a block: those that did not count are repeated at its end."""
        own = [row for row in self.rows if row.block == block]
        answered = {row.this_n for row in own if row.event == "trial"}
        pending = [trial for trial in self._schedule.trials if trial.block == block and trial.index not in answered]
        return min(pending, key=lambda trial: (self._attempts(trial.index, own), trial.index), default=None)

    def _pending_practice(self) -> OrderTrial | None:
        """Return the next practice trial; None once a round was good enough, or after the last round."""
        order = self._order
        if not order.practice or any(row.block is not None for row in self.rows):
            return None
        answered = [row for row in self.rows if row.event == "practice"]
        rounds, within = divmod(len(answered), order.practice)
        if not within and rounds:
            last = answered[-order.practice :]
            if sum(row.pairs_correct or 0 for row in last) >= order.practice_pairs or rounds >= order.practice_rounds:
                return None
        return self._schedule.practice[len(answered)]

    def _begin_trial(self, trial: OrderTrial, now_us: int) -> None:
        if not self._met:
            self._meet(now_us)
            return
        self.trial = trial
        self._typed = self._keys = ""
        self._answer_us = None
        self.deepest_m = None
        self._stimulus = stimulus_of(
            self._plan,
            self.condition,
            self._law,
            number=trial.index,
            breach_forces_n=trial.breach_forces_n,
            seed=trial.seed + self._attempts_of(trial),  # another motion of a simulated hand when it is repeated
        )
        self._perform(self._screens.trial("", self._progress()), self._stimulus, now_us)

    def _attempts_of(self, trial: OrderTrial) -> int:
        practising = trial.condition is None
        return self._attempts(trial.index, [row for row in self.rows if (row.condition == PRACTICE) == practising])

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
        """Return the first tissue known not to be pushed into by the needle."""
        if self.deepest_m is None or not isinstance(self.activity, Stimulus):
            return None
        for number, tissue in enumerate(self.activity.tissues, start=1):
            if self.deepest_m < tissue.rest_position_m + TOUCHED * tissue.breach_depth_m:
                return number
        return None

    def _judge(self, outcome: Outcome, values: dict[str, Any]) -> tuple[Event, str | None, str]:
        if self._answer_us is None or self.trial is None:
            return "aborted", f"no answer within {self._order.time_limit_s:g} s", "late"
        measures = outcome.measures if isinstance(outcome, Played) else NO_MEASURES
        pairs = right_pairs(self.trial.order, self._typed)
        response_s = (self._answer_us - self._shown_us) / 1e6
        contact_s = measures.first_contact_s
        values |= {
            "order_answered": self._typed,
            "correct": int(self._typed == self.trial.order),
            "pairs_correct": pairs,
            "response_time_s": response_s,
            "contact_to_answer_s": None if contact_s is None else response_s - contact_s,
            "key": self._keys,
        }
        why = "undelivered" if measures.touched_all else "untouched"
        return "repeated", measures.undelivered(self._order.least_delivered), why

    def _accept(self, values: dict[str, Any], now_us: int) -> None:
        if values["condition"] == PRACTICE:
            self._emit("practice", now_us, since_us=self._shown_us, **values)
            self._show(self._screens.feedback(self._typed, values["order_true"], now_us), now_us)
        else:
            self._emit("trial", now_us, since_us=self._shown_us, **values)
            self._go_on(now_us)

    def _values(self, outcome: Outcome | None) -> dict[str, Any]:
        trial, stimulus = self.trial, self._stimulus
        if trial is None or stimulus is None:
            return {}
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
        for number, tissue in enumerate(stimulus.tissues, start=1):
            values[f"breach_force_{number}_n"] = tissue.breach_force_n
            values[f"stiffness_{number}_n_per_m"] = tissue.stiffness_n_per_m
        if outcome is not None:
            values |= _measured(outcome.measures if isinstance(outcome, Played) else NO_MEASURES)
        return values


def _measured(measures: Measures) -> dict[str, Any]:
    values = asdict(measures)
    for kind in ("held", "sensed"):
        for number, peak_n in enumerate(values.pop(f"peaks_{kind}_n"), start=1):
            values[f"peak_{kind}_{number}_n"] = peak_n
    return values


def right_pairs(true: str, answered: str) -> int:
    """Return how many pairs of tissues are in the right order in an answer such as "213"."""
    return sum(answered.index(softer) < answered.index(harder) for softer, harder in combinations(true, 2))


class LimitsFlow(Flow[LimitsRow]):
    """The measurement of the JND: pairs of forces, each with a question."""

    kind = LimitsRow
    schedule_kind = LimitsSchedule
    item = "pair"
    _schedule: LimitsSchedule

    def _prepare(self) -> None:
        self._part = self._limits = self._plan.limits
        schedule = self._schedule
        answers = [row.answer for row in self.rows if row.event == "trial" and row.answer is not None]
        self.procedure = Procedure(self._limits, schedule.series, schedule.intervals, answers)
        self.presented: Presented | None = None  # the present pair
        self._question: Question | None = None
        self._presented_us = 0

    @property
    def _instructions(self) -> str:
        """Also the name of the question."""
        return "ascending" if self._limits.method == "ascending" else "choice"

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
            screen = self._screens.make(ScreenKind.STIMULI, "stimuli", "stop", progress=self._progress())
            self._perform(screen, pair, now_us)

    def _break_is_due(self, series: int) -> bool:
        return self._breaks < PARTS - 1 and series >= (self._breaks + 1) * len(self._schedule.series) / PARTS

    def _progress(self) -> str:
        words = self._plan.texts.screens
        return words["series"].format(done=len(self.procedure.thresholds), all=len(self._schedule.series))

    def _take_key(self, key: str, now_us: int) -> None:
        if self.screen.kind is not ScreenKind.QUESTION or self._question is None:
            return
        answer, right = ANSWERS[key], None
        if self._limits.method != "ascending":
            right = int(answer == str(self._question.comparison_interval))
        values = self._values(self.presented) | {
            "answer": answer,
            "correct": right,
            "key": key,
            "response_time_s": (now_us - self._presented_us) / 1e6,
        }
        self._emit("trial", now_us, since_us=self._shown_us, **values)
        self.procedure.answer(answer)
        self.presented = None
        self._go_on(now_us)

    def _judge(self, outcome: Outcome, values: dict[str, Any]) -> tuple[Event, str | None, str]:
        del values
        self.presented = outcome if isinstance(outcome, Presented) else None
        missed = "nothing was presented" if self.presented is None else self.presented.missed(self._limits.tolerance)
        return "repeated", missed, "undelivered"

    def _accept(self, values: dict[str, Any], now_us: int) -> None:
        del values
        asked, actions = self._instructions, ("same", "different")
        if asked == "choice":
            actions = "first", "second"
        self._presented_us, shown_us = now_us, self._shown_us
        self._show(self._screens.make(ScreenKind.QUESTION, asked, *actions, "end", progress=self._progress()), now_us)
        self._shown_us = shown_us  # the row begins with the stimuli

    def _values(self, outcome: Outcome | None) -> dict[str, Any]:
        question = self._question
        if question is None:
            return {}
        number = sum(row.event == "trial" for row in self.rows)  # the number of the previous answers
        sensed_n = outcome.sensed_n if isinstance(outcome, Presented) else (None, None)
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
            "held_1_n": question.forces_n[0],
            "held_2_n": question.forces_n[1],
            "sensed_1_n": sensed_n[0],
            "sensed_2_n": sensed_n[1],
        }


def device_errors_n(rows: Sequence[LimitsRow]) -> dict[float, list[float]]:
    """Return sensed minus held force [N] of every answered stimulus, by reference."""
    found: dict[float, list[float]] = {}
    for row in rows:
        if row.event != "trial" or row.reference_n is None:
            continue
        for held_n, sensed_n in ((row.held_1_n, row.sensed_1_n), (row.held_2_n, row.sensed_2_n)):
            if held_n is not None and sensed_n is not None:
                found.setdefault(row.reference_n, []).append(sensed_n - held_n)
    return found
