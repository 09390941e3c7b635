"""What every task has: a plan that is sent to workers, and a runner that computes its runs."""

from typing import Final, Protocol

import numpy as np

from hapticnet.errors import in_words
from hapticnet.sweep.grid import Shard
from hapticnet.sweep.link import Columns, Row

RUN_COLUMNS: Final[Columns] = {"run": "int", "repeat": "int"}
ERROR_COLUMNS: Final[Columns] = {"error": "text"}

FOR_REPEAT: Final = 1
"""Second part of the spawn key of what all combinations of a repeat share, such as the motion of the hand."""


class Plan(Protocol):
    """A study with its files read and its combinations counted. It can be pickled."""

    @property
    def name(self) -> str:
        """Name of the study."""
        ...

    @property
    def digest(self) -> str:
        """SHA-256 of all that determines its numbers, except how often it is repeated."""
        ...

    @property
    def seed(self) -> int:
        """Seed of all random numbers."""
        ...

    @property
    def repeats(self) -> int:
        """How often every combination is run."""
        ...

    @property
    def cells(self) -> int:
        """Number of combinations."""
        ...

    @property
    def sharing(self) -> int:
        """So many combinations in a row share most of their work, so a shard better has all of them."""
        ...

    @property
    def columns(self) -> Columns:
        """Columns of a row, besides those that every task has."""
        ...

    @property
    def measures(self) -> tuple[str, ...]:
        """Those of the columns that a run measures; the others tell combinations apart."""
        ...

    def runner(self) -> "Runner":
        """Return what computes its runs in this process."""
        ...


class Runner(Protocol):
    """Computes runs. It may keep what several of them need, but no result may depend on which runs it did before."""

    def settings(self, cell: int) -> Row:
        """Return the columns that tell a combination from others."""
        ...

    def measure(self, repeat: int, cell: int, rng: np.random.Generator) -> Row:
        """Return what a run finds. The generator belongs to this run alone."""
        ...


def all_columns(plan: Plan) -> Columns:
    """Return all columns of the rows of a plan."""
    return {**RUN_COLUMNS, **plan.columns, **ERROR_COLUMNS}


def runs_of(plan: Plan) -> int:
    """Return the number of runs of a plan."""
    return plan.cells * plan.repeats


def rng_of_run(seed: int, run: int) -> np.random.Generator:
    """Return the random numbers of a run: the same in any shard, worker and order."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(run,)))


def rng_of_repeat(seed: int, repeat: int) -> np.random.Generator:
    """Return the random numbers that all combinations of a repeat share, so that they meet the same hand."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(repeat, FOR_REPEAT)))


def rows_of(plan: Plan, runner: Runner, shard: Shard) -> list[Row]:
    """Return the rows of a shard. A run that fails has its error in the place of its figures."""
    cells = plan.cells
    nothing: Row = dict.fromkeys(all_columns(plan))
    rows = []
    for run in range(shard.first, shard.end):
        repeat, cell = divmod(run, cells)
        row = nothing | {"run": run, "repeat": repeat} | runner.settings(cell)
        try:
            row |= runner.measure(repeat, cell, rng_of_run(plan.seed, run))
        except (MemoryError, OSError):  # of this machine, not of this run
            raise
        except Exception as error:  # a user's codec may raise anything
            row["error"] = in_words(error)
        rows.append(row)
    return rows
