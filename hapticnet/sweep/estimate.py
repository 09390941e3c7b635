"""How long a study takes and how much it stores, from a few of its runs."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from hapticnet.sweep.conduct import SHARD_S
from hapticnet.sweep.grid import Shard
from hapticnet.sweep.runs import Plan, all_columns, rows_of, runs_of
from hapticnet.sweep.table import origin, shard_bytes

PLACES: Final = 5
RUNS_EACH: Final = 4
"""Runs are timed at so many places of the study, so many in a row, since neighbours share work."""

LONGEST_S: Final = 20.0
"""Time [s] after which no further place is tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What a study takes.

    Attributes
    ----------
    timed
        Number of runs that were timed.
    seconds_per_run, worker_seconds
        Time of one run and of all [s], on one worker like this machine.
    seconds
        Time with so many workers [s].
    shards, bytes
        Number and size [B] of the files.
    """

    timed: int
    seconds_per_run: float
    worker_seconds: float
    seconds: float
    shards: int
    bytes: int


def estimate(
    plan: Plan, workers: int, *, shard_runs: int | None = None, clock: Callable[[], float] = time.perf_counter
) -> Estimate:
    """Run a few runs of a study and return what all of it takes."""
    runs = runs_of(plan)
    each = min(-(-RUNS_EACH // plan.sharing) * plan.sharing, runs)
    places = sorted({place * (runs - each) // (PLACES - 1) // plan.sharing * plan.sharing for place in range(PLACES)})
    runner, rows = plan.runner(), []
    began_s = clock()
    for first in places:
        rows += rows_of(plan, runner, Shard(first, first + each))
        if clock() - began_s > LONGEST_S:
            break
    per_run_s = (clock() - began_s) / len(rows)
    whole_s = per_run_s * runs
    in_shard = shard_runs or max(1, round(SHARD_S / per_run_s))
    shards = -(-runs // in_shard)
    content = shard_bytes(all_columns(plan), rows, origin(plan.digest, Shard(0, len(rows))))
    empty = shard_bytes(all_columns(plan), [], origin(plan.digest, Shard(0, 0)))
    size = shards * len(empty) + runs * (len(content) - len(empty)) // len(rows)
    return Estimate(
        timed=len(rows),
        seconds_per_run=per_run_s,
        worker_seconds=whole_s,
        seconds=whole_s / workers,
        shards=shards,
        bytes=size,
    )
