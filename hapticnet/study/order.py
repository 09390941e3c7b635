"""The ordering task: its schedule, and the session in which three tissues are ordered by stiffness."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, permutations
from typing import Any, Final

import numpy as np

from hapticnet.perception import WeberLaw
from hapticnet.study import screens
from hapticnet.study.flow import Flow
from hapticnet.study.plan import ConditionPlan, Plan, QuestionPlan
from hapticnet.study.rig import LIFTED, Activity, Fault, Outcome, Play
from hapticnet.study.rows import OrderRow
from hapticnet.study.schedule import LARGEST_SEED, Schedule, generator, participant_number
from hapticnet.study.screens import ScreenKind
from hapticnet.study.trial import NO_MEASURES, Measures, Played, Stimulus, stimulus_of

ORDERS: Final = tuple(permutations(range(3)))
"""The six orders of three tissues."""

PRACTICE: Final = "practice"
"""What practice trials have in the column of the condition."""

TOUCHED: Final = 0.5
"""Share of its breach depth to which the needle must have pushed a tissue in before an answer is taken. The same depth
for each, so that a refused answer tells nothing about the stiffness."""

UNCOMPRESSED: Final = ConditionPlan(name=PRACTICE, codec="raw", multiplier=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderTrial:
    """One trial of the ordering task."""

    index: int  # number in the schedule, from 0; practice trials have their own numbers
    block: int
    condition: int | None  # number in the plan; None in practice, which is not compressed
    repetition: int  # how often its condition came before
    breach_forces_n: tuple[float, ...]  # front to back
    seed: int  # of everything random within the trial

    @property
    def order(self) -> str:
        """The tissues from softest to hardest, such as "213"."""
        numbered = sorted(range(len(self.breach_forces_n)), key=self.breach_forces_n.__getitem__)
        return "".join(str(number + 1) for number in numbered)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderSchedule(Schedule):
    """The trials of a session in the order in which they come, and the practice trials of all rounds."""

    practice: tuple[OrderTrial, ...]
    trials: tuple[OrderTrial, ...]

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return self.trials[-1].block + 1

    def lines(self, plan: Plan) -> list[str]:
        """Return the schedule for a person: a line for each block, with the orders of the tissues."""
        told = [f"participant {self.participant}, session {self.session}: {len(self.trials)} trials, seed {self.seed}"]
        told += [f"  practice: {' '.join(trial.order for trial in self.practice)}"] if self.practice else []
        for block in range(self.blocks):
            trials = [each for each in self.trials if each.block == block]
            own = [(plan.condition[each.condition or 0].name, each.order) for each in trials]
            names = {name for name, _ in own}
            orders = [order if len(names) == 1 else f"{name} {order}" for name, order in own]
            separator = " " if len(names) == 1 else ", "
            told.append(f"  block {block + 1}, {' and '.join(sorted(names))}: {separator.join(orders)}")
        return told

    @classmethod
    def _restored(cls, content: dict[str, Any]) -> dict[str, Any]:
        trials = {
            name: tuple(
                OrderTrial(**{**each, "breach_forces_n": tuple(each["breach_forces_n"])}) for each in content[name]
            )
            for name in ("practice", "trials")
        }
        return content | trials


def williams_square(conditions: int) -> tuple[tuple[int, ...], ...]:
    """Return orders of conditions in which each comes equally often at each place and after each other one.

    With an even number there are as many orders as conditions, with an odd one twice as many. E. J. Williams,
    "Experimental designs balanced for the estimation of residual effects of treatments", 1949.
    """
    first = [0]
    for place in range(1, conditions):
        first.append((place + 1) // 2 if place % 2 else conditions - place // 2)
    rows = [tuple((each + row) % conditions for each in first) for row in range(conditions)]
    if conditions % 2:
        rows += [tuple(reversed(row)) for row in rows]
    return tuple(rows)


def draw_order(plan: Plan, participant: str, session: int, seed: int) -> OrderSchedule:
    """Return the schedule of a session of the ordering task.

    Conditions come in the participant's row of a Williams square. Each condition runs through all six orders of the
    tissues before one repeats.

    Raises
    ------
    SettingsError
        If participant or session is not a number, or the seed is negative.
    """
    rng, number = generator(participant, session, seed, 1), participant_number(participant)
    row = williams_square(len(plan.condition))
    order, conditions = plan.order, len(plan.condition)
    forces_n = [_forces(plan, order.trials, rng) for _ in range(conditions)]
    sequence: list[tuple[int, int, int]] = []  # block, condition, repetition
    if order.arrangement == "blocked":
        own = row[(number - 1) % len(row)]
        sequence = [(block, own[block], each) for block in range(conditions) for each in range(order.trials)]
    else:
        for repetition in range(order.trials):
            now = row[(number - 1 + repetition) % len(row)]
            # As many trials make a block, and so come between two breaks, as in a blocked session.
            start = repetition * conditions
            sequence += [((start + place) // order.trials, now[place], repetition) for place in range(conditions)]
    practice_n = _forces(plan, max(1, order.practice * order.practice_rounds), rng)
    seeds = rng.integers(LARGEST_SEED, size=len(sequence) + len(practice_n)).tolist()
    trials = tuple(
        OrderTrial(
            index=index,
            block=block,
            condition=condition,
            repetition=repetition,
            breach_forces_n=forces_n[condition][repetition],
            seed=seeds[index],
        )
        for index, (block, condition, repetition) in enumerate(sequence)
    )
    practice = tuple(
        OrderTrial(
            index=index,
            block=index // max(1, order.practice),
            condition=None,
            repetition=index,
            breach_forces_n=practice_n[index],
            seed=seeds[len(sequence) + index],
        )
        for index in range(order.practice * order.practice_rounds)
    )
    return OrderSchedule(
        participant=participant, session=session, seed=seed, plan=plan.digest(), practice=practice, trials=trials
    )


def _forces(plan: Plan, trials: int, rng: np.random.Generator) -> list[tuple[float, ...]]:
    """Return breach forces [N] of so many trials, each run of six with all orders."""
    drawn: list[tuple[float, ...]] = []
    while len(drawn) < trials:
        for index in rng.permutation(len(ORDERS)).tolist():
            drawn.append(tuple(plan.order.breach_forces_n[each] for each in ORDERS[index]))
    return drawn[:trials]


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
        rows: Sequence[OrderRow],
        now_us: int,
        constants: dict[str, Any],
        questions: Sequence[QuestionPlan] = (),
    ) -> None:
        self.trial: OrderTrial | None = None
        self._order = plan.order
        self._schedule = schedule
        self._law = law
        self._typed = ""
        self._keys = ""
        self._answer_us: int | None = None
        self._rounds_shown = 0
        constants = constants | {"weber_fraction": law.weber_fraction, "floor_n": law.floor_n}
        super().__init__(plan, plan.order, rows, now_us, constants, questions, plan.texts.instructions["order"])

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
                self._show(self._screens.practice(practice.block), now_us)
            else:
                self._begin_trial(practice, now_us)
            return
        rates = self._order.rating and self._order.arrangement == "blocked"
        for block in range(self._schedule.blocks):
            trial = self._pending(block)
            if trial is not None:
                self._begin_trial(trial, now_us)
                return
            if rates and not any(row.event == "rating" and row.block == block for row in self.rows):
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
        """Return the next trial of a block: those that did not count come again at its end."""
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
        stimulus = stimulus_of(
            self._plan,
            self.condition,
            self._law,
            number=trial.index,
            breach_forces_n=trial.breach_forces_n,
            seed=trial.seed + self._attempts_of(trial),  # another motion of a simulated hand when it comes again
        )
        self._emit("started", now_us, **self._values(trial, stimulus))
        self._show(self._screens.trial("", self._progress()), now_us, Play(stimulus))

    def _attempts_of(self, trial: OrderTrial) -> int:
        """Return how often a trial was begun in this run and earlier ones."""
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
        event, reason, why = "aborted", abort, "stopped"
        if reason is None and isinstance(outcome, Fault | Played):
            reason = outcome.reason if isinstance(outcome, Fault) else outcome.failure
            why = "lifted" if reason == LIFTED else "fault"
        if reason is None and self._answer_us is None:
            reason, why = f"no answer within {self._order.time_limit_s:g} s", "late"
        measures = outcome.measures if isinstance(outcome, Played) else NO_MEASURES
        values = self._values(trial, activity.stimulus) | _measured(measures)
        if reason is None:
            values |= self._answer(trial, measures)
            reason = measures.undelivered(self._order.least_delivered)
            event, why = "repeated", "undelivered" if measures.touched_all else "untouched"
        if reason is not None:
            self._emit(
                "repeated" if event == "repeated" else "aborted", now_us, since_us=self._shown_us, reason=reason,
                **values,
            )  # fmt: skip
            self._repeat(trial.index, f"trial {trial.index} was begun", reason, why, now_us)
            return
        practising = trial.condition is None
        self._emit("practice" if practising else "trial", now_us, since_us=self._shown_us, **values)
        if practising:
            self._show(self._screens.feedback(self._typed, trial.order, now_us), now_us)
        else:
            self._go_on(now_us)

    def _values(self, trial: OrderTrial, stimulus: Stimulus) -> dict[str, Any]:
        """Return the columns of a trial that are known before it begins."""
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
        return values

    def _answer(self, trial: OrderTrial, measures: Measures) -> dict[str, Any]:
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


def _measured(measures: Measures) -> dict[str, Any]:
    """Return the columns of a trial that was played, answered or not."""
    values = asdict(measures)
    for kind in ("held", "sensed"):
        for number, peak_n in enumerate(values.pop(f"peaks_{kind}_n"), start=1):
            values[f"peak_{kind}_{number}_n"] = peak_n
    return values


def right_pairs(true: str, answered: str) -> int:
    """Return how many pairs of tissues are in the right order in an answer such as "213"."""
    return sum(answered.index(softer) < answered.index(harder) for softer, harder in combinations(true, 2))
