"""Everything random of a session, drawn before it begins, from one seed, and stored."""

import json
import re
from dataclasses import asdict, dataclass
from itertools import permutations
from typing import Any, Final

import numpy as np

from hapticnet.checks import check_integer
from hapticnet.errors import FileError, SettingsError
from hapticnet.study.plan import Plan

LARGEST_SEED: Final = 2**31
ORDERS: Final = tuple(permutations(range(3)))
"""The six orders of three tissues."""


def participant_number(participant: str) -> int:
    """Return the number of a participant such as "03".

    Raises
    ------
    SettingsError
        If it is not a number. Names are not stored.
    """
    if not re.fullmatch(r"[0-9]{1,6}", participant):
        raise SettingsError(f"participant {participant[:40]!r}: expected a number such as 03; names are not stored")
    return int(participant)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One trial of the ordering task.

    Attributes
    ----------
    index
        Number in the schedule, from 0; practice trials have their own numbers.
    block
        Number of its block.
    condition
        Number of its condition in the plan; None in practice, which is not compressed.
    repetition
        How often its condition came before.
    breach_forces_n
        Breach forces [N], front to back.
    seed
        Seed of everything random within the trial.
    """

    index: int
    block: int
    condition: int | None
    repetition: int
    breach_forces_n: tuple[float, ...]
    seed: int

    @property
    def order(self) -> str:
        """The tissues from softest to hardest, such as "213"."""
        numbered = sorted(range(len(self.breach_forces_n)), key=self.breach_forces_n.__getitem__)
        return "".join(str(number + 1) for number in numbered)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderSchedule:
    """The trials of a session.

    Attributes
    ----------
    practice
        Practice trials of all rounds, one after the other.
    trials
        The trials in the order in which they come.
    """

    participant: str
    session: int
    seed: int
    plan: str
    practice: tuple[Trial, ...]
    trials: tuple[Trial, ...]

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return self.trials[-1].block + 1

    def lines(self, plan: Plan) -> list[str]:
        """Return the schedule for a person: a line for each block, with the orders of the tissues."""
        told = [f"participant {self.participant}, session {self.session}: {len(self.trials)} trials, seed {self.seed}"]
        told += [f"  practice: {' '.join(trial.order for trial in self.practice)}"] if self.practice else []
        for block in range(self.blocks):
            own = [
                (plan.condition[each.condition or 0].name, each.order) for each in self.trials if each.block == block
            ]
            names = {name for name, _ in own}
            orders = [order if len(names) == 1 else f"{name} {order}" for name, order in own]
            separator = " " if len(names) == 1 else ", "
            told.append(f"  block {block + 1}, {' and '.join(sorted(names))}: {separator.join(orders)}")
        return told

    def to_json(self) -> str:
        """Return the schedule as text."""
        return json.dumps(asdict(self), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str, source: str) -> "OrderSchedule":
        """Return the schedule in a text; raise FileError if it is none."""
        try:
            content: dict[str, Any] = json.loads(text)
            for name in ("practice", "trials"):
                content[name] = tuple(
                    Trial(**{**each, "breach_forces_n": tuple(each["breach_forces_n"])}) for each in content[name]
                )
            return cls(**content)
        except (ValueError, TypeError, KeyError) as error:
            raise FileError(f"{source}: not a schedule: {error}") from error


def draw_order(plan: Plan, participant: str, session: int, seed: int) -> OrderSchedule:
    """Return the schedule of a session of the ordering task.

    Conditions come in the participant's row of a Williams square. Each condition runs through all six orders of the
    tissues before one repeats.

    Raises
    ------
    SettingsError
        If participant or session is not a number, or the seed is negative.
    """
    number = participant_number(participant)
    check_integer("session", session, 1, 1000)
    check_integer("seed", seed, 0, LARGEST_SEED)
    rng = np.random.default_rng([seed, number, session, 1])
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
        Trial(
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
        Trial(
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
