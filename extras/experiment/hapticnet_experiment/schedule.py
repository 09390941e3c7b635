"""All random choices of a session, drawn before it begins, from one seed, and stored."""

import json
import re
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from itertools import permutations
from typing import Final, Self

import numpy as np
from pydantic import TypeAdapter, ValidationError

from hapticnet.checks import check_integer
from hapticnet.errors import FileError, SettingsError
from hapticnet_experiment.plan import Plan

LARGEST_SEED: Final = 2**31
ORDERS: Final = tuple(permutations(range(3)))  # the six orders of three tissues
CATCH_PAIRS: Final = (3, 10)  # smallest and largest number of pairs in a catch series


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule(ABC):
    """The common part of both tasks' schedules."""

    participant: str
    session: int
    seed: int
    plan: str  # digest of the plan

    @classmethod
    @abstractmethod
    def draw(cls, plan: Plan, participant: str, session: int, seed: int) -> Self:
        """Return the schedule of a session; raise SettingsError if a number is invalid."""

    def to_json(self) -> str:
        """Return the schedule as text."""
        return json.dumps(asdict(self), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str, source: str) -> Self:
        """Return the schedule in a text; raise FileError if it is invalid."""
        try:
            return TypeAdapter(cls).validate_json(text)
        except ValidationError as error:
            raise FileError(f"{source}: not a schedule: {error.errors()[0]['msg']}") from error


def participant_number(participant: str) -> int:
    """Return the number of a participant such as "03"; raise SettingsError if it is invalid. Names are not stored."""
    if not re.fullmatch(r"[0-9]{1,6}", participant):
        raise SettingsError(f"participant {participant[:40]!r}: expected a number such as 03; names are not stored")
    return int(participant)


def _generator(participant: str, session: int, seed: int, part: int) -> tuple[np.random.Generator, int]:
    """Return the random generator for a part of a session, and the number of the participant."""
    number = participant_number(participant)
    check_integer("session", session, 1, 1000)
    check_integer("seed", seed, 0, LARGEST_SEED)
    return np.random.default_rng([seed, number, session, part]), number


@dataclass(frozen=True, slots=True)
class OrderTrial:
    """One trial of the ordering task."""

    index: int  # number in the schedule, from 0; practice trials have their own numbers
    block: int
    condition: int | None  # number in the plan; None in practice, which is not compressed
    repetition: int  # earlier trials of its condition
    breach_forces_n: tuple[float, ...]  # front to back
    seed: int  # seed of all random numbers in the trial

    @property
    def order(self) -> str:
        """The tissues from softest to hardest, such as "213"."""
        numbered = sorted(range(len(self.breach_forces_n)), key=self.breach_forces_n.__getitem__)
        return "".join(str(number + 1) for number in numbered)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderSchedule(Schedule):
    """The trials of a session in order, and the practice trials of all rounds."""

    practice: tuple[OrderTrial, ...]
    trials: tuple[OrderTrial, ...]

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return self.trials[-1].block + 1

    @classmethod
    def draw(cls, plan: Plan, participant: str, session: int, seed: int) -> Self:
        """Return the schedule of an ordering task.

        Conditions come in the participant's row of a Williams square. Each condition runs through all six orders of the
        tissues before one repeats.
        """
        rng, number = _generator(participant, session, seed, 1)
        row = williams_square(len(plan.condition))
        order, conditions = plan.order, len(plan.condition)
        forces_n = [_forces(plan, order.trials, rng) for _ in range(conditions)]
        sequence: list[tuple[int, int, int]] = []  # block, condition, repetition
        own = row[(number - 1) % len(row)]
        for block in range(conditions):
            sequence += [(block, own[block], repetition) for repetition in range(order.trials)]
        practice_n = _forces(plan, max(1, order.practice * order.practice_rounds), rng)
        seeds = rng.integers(LARGEST_SEED, size=len(sequence) + len(practice_n)).tolist()
        trials = tuple(
            OrderTrial(index, block, condition, repetition, forces_n[condition][repetition], seeds[index])
            for index, (block, condition, repetition) in enumerate(sequence)
        )
        practice = tuple(
            OrderTrial(index, index // order.practice, None, index, practice_n[index], seeds[len(sequence) + index])
            for index in range(order.practice * order.practice_rounds)
        )
        return cls(
            participant=participant, session=session, seed=seed, plan=plan.digest(), practice=practice, trials=trials
        )


def williams_square(conditions: int) -> tuple[tuple[int, ...], ...]:
    """Return orders of conditions in which each occurs equally often at each place and after each other one.

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


def _forces(plan: Plan, trials: int, rng: np.random.Generator) -> list[tuple[float, ...]]:
    """Return breach forces [N] of this many trials, each run of six with all orders."""
    drawn: list[tuple[float, ...]] = []
    while len(drawn) < trials:
        for index in rng.permutation(len(ORDERS)).tolist():
            drawn.append(tuple(plan.order.breach_forces_n[each] for each in ORDERS[index]))
    return drawn[:trials]


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
class LimitsSchedule(Schedule):
    """The series of a measurement of the JND, and the interval of the comparison in each pair, 1 or 2."""

    series: tuple[Series, ...]
    intervals: tuple[int, ...]

    @classmethod
    def draw(cls, plan: Plan, participant: str, session: int, seed: int) -> Self:
        """Return the schedule of a measurement.

        The references come in a Latin square by repetition and participant; catch series are at random places.
        """
        rng, number = _generator(participant, session, seed, 2)
        limits, references = plan.limits, plan.limits.references_n
        series: list[Series] = []
        for repetition in range(limits.repetitions):
            shift = number - 1 + repetition
            rotated = [references[(place + shift) % len(references)] for place in range(len(references))]
            turned = rotated if (number - 1 + repetition // len(references)) % 2 == 0 else rotated[::-1]
            for reference_n in turned:  # starts are on a grid of a tenth of a step
                start = round(float(rng.uniform(0.0, limits.start)) / (0.1 * limits.step)) * 0.1 * limits.step
                series.append(Series(reference_n=reference_n, start=start))
        fewest, most = CATCH_PAIRS
        for index in range(round(limits.catch * len(series))):
            reference_n = references[(index + number) % len(references)]
            pairs = int(rng.integers(fewest, most + 1))
            series.insert(int(rng.integers(len(series) + 1)), Series(reference_n=reference_n, start=0.0, pairs=pairs))
        if limits.method != "ascending":
            series = [Series(reference_n=each.reference_n, start=0.0) for each in series if not each.catch]
        intervals = tuple(rng.integers(1, 3, limits.pairs * len(series)).tolist())
        return cls(
            participant=participant,
            session=session,
            seed=seed,
            plan=plan.digest(),
            series=tuple(series),
            intervals=intervals,
        )
