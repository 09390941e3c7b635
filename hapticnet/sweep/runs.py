"""The runs of a study, numbered, and their rows: a plan is pickled for workers, where a runner computes them."""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, NamedTuple, TypeAlias

import numpy as np

from hapticnet.errors import in_words

Kind: TypeAlias = Literal["int", "float", "text"]
Columns: TypeAlias = dict[str, Kind]  # names and types of the columns of a table
Row: TypeAlias = dict[str, Any]  # one run: a value, or None, for each column
RUN_COLUMNS: Final[Columns] = {"run": "int", "repeat": "int"}
ERROR_COLUMNS: Final[Columns] = {"error": "text"}
FOR_REPEAT: Final = 1  # spawn key of random numbers shared by a repeat's combinations, such as the hand's motion


@dataclass(frozen=True, slots=True)
class Grid:
    """The product of some axes. The last axis changes fastest."""

    axes: tuple[tuple[Any, ...], ...]

    def __len__(self) -> int:
        return math.prod(len(axis) for axis in self.axes)

    def __getitem__(self, cell: int) -> tuple[Any, ...]:
        values: list[Any] = []
        for axis in reversed(self.axes):
            cell, place = divmod(cell, len(axis))
            values.append(axis[place])
        return tuple(reversed(values))


class Shard(NamedTuple):
    """Runs that are computed and stored together: from `first` to before `end`."""

    first: int
    end: int

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.end - self.first


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan(ABC):
    """A study with its files read and its combinations counted."""

    task: ClassVar[str]
    measured: ClassVar[Columns]  # measures of a run; docs/use/compare.md explains each

    name: str
    seed: int
    repeats: int  # how often every combination is run
    grid: Grid
    swept: tuple[str, ...]  # parameters of codecs that the study varies
    digest: str = ""  # SHA-256 of everything that determines the numbers, except the repeats

    @property
    def cells(self) -> int:
        """Number of combinations."""
        return len(self.grid)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.cells * self.repeats

    @property
    def sharing(self) -> int:
        """Number of combinations in a row that share most of their work, so a shard should contain all of them."""
        return 1

    @property
    @abstractmethod
    def settings(self) -> Columns:
        """Columns that distinguish combinations."""

    @property
    def columns(self) -> Columns:
        """All columns of a row."""
        return {**RUN_COLUMNS, **self.settings, **self.measured, **ERROR_COLUMNS}

    @abstractmethod
    def runner(self) -> "Runner":
        """Return a runner that computes its runs in this process."""


class Runner(ABC):
    """Computes runs. It may cache shared work, but no result may depend on earlier runs."""

    @abstractmethod
    def settings(self, cell: int) -> Row:
        """Return the columns that identify a combination."""

    @abstractmethod
    def measure(self, repeat: int, cell: int, rng: np.random.Generator) -> Row:
        """Return the measures of a run. The generator belongs to this run alone."""


def rng_of_repeat(seed: int, repeat: int) -> np.random.Generator:
    """Return the random numbers that all combinations of a repeat share, so that they meet the same hand."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(repeat, FOR_REPEAT)))


def rows_of(plan: Plan, runner: Runner, shard: Shard) -> list[Row]:
    """Return the rows of a shard: the same in any shard, worker and order. A run that fails has its error instead."""
    nothing: Row = dict.fromkeys(plan.columns)
    rows = []
    for run in range(shard.first, shard.end):
        repeat, cell = divmod(run, plan.cells)
        row = nothing | {"run": run, "repeat": repeat} | runner.settings(cell)
        rng = np.random.default_rng(np.random.SeedSequence(entropy=plan.seed, spawn_key=(run,)))
        try:
            row |= runner.measure(repeat, cell, rng)
        except (MemoryError, OSError):  # a fault of this machine, not of this run
            raise
        except Exception as error:  # a user's codec may raise anything
            row["error"] = in_words(error)
        rows.append(row)
    return rows


def overlap(shards: Sequence[Shard]) -> tuple[Shard, Shard] | None:
    """Return two shards that have a run in common; None if there are none."""
    return next(((one, other) for one, other in itertools.pairwise(sorted(shards)) if one.end > other.first), None)


class Cutter:
    """Cuts the runs that are in no shard yet into shards."""

    def __init__(self, there: Iterable[Shard], runs: int) -> None:
        gaps, at = [], 0
        for shard in [*sorted(there), Shard(runs, runs)]:
            if shard.first > at:
                gaps.append(Shard(at, shard.first))
            at = shard.end
        self._gaps = gaps[::-1]
        self.left = sum(gap.runs for gap in gaps)

    def cut(self, most: int) -> Shard | None:
        """Return the next shard of at most this many runs; None if nothing is left."""
        if not self._gaps:
            return None
        gap = self._gaps.pop()
        end = min(gap.end, gap.first + max(1, most))
        if end < gap.end:
            self._gaps.append(Shard(end, gap.end))
        self.left -= end - gap.first
        return Shard(gap.first, end)
