"""The engine of a sweep: cut the missing runs into shards, give them to a pool of workers, and store each result."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

from hapticnet.errors import FileError, HapticnetError, UnavailableError, in_words
from hapticnet.experiment.workers import EndedError, Outcome
from hapticnet.sweep.plan import Plan
from hapticnet.sweep.pools import AnyPool
from hapticnet.sweep.runs import Cutter, Shard
from hapticnet.sweep.store import Computed, Store

SHARD_S: Final = 3.0  # duration of a shard [s]: long compared with the cost of storing it, but short to wait for
SHORTEST_S: Final = 0.3  # duration of the last shards [s], so that all workers end at about the same time
FIRST_RUNS: Final = 2  # runs in a shard before the duration of a run is known
GROWTH: Final = 8  # largest growth factor between shards: the first ones include the start of a worker
WINDOW: Final = 8
POLL_S: Final = 0.25
ATTEMPTS: Final = 3  # tries of a shard whose worker ends
HOPELESS: Final = 5  # if this many shards fail, and none succeeded, the sweep ends


@dataclass(slots=True)
class Progress:
    """The progress of a sweep."""

    runs: int  # runs of the study
    done: int = 0  # stored runs
    computed: int = 0  # runs that this sweep computed and stored
    shards: int = 0  # shards that this sweep stored
    failed: int = 0  # computed runs that have an error instead of measures
    first_error: str | None = None
    lost_workers: int = 0  # workers that ended while computing
    poison: list[Shard] = field(default_factory=list)  # abandoned shards
    first_reason: str | None = None  # the reason for the first of them
    worker_seconds: float = 0.0
    worker_cpu_seconds: float = 0.0  # sums of the shards' durations and processor times [s]
    seconds: float = 0.0  # duration of this sweep so far [s]
    workers: int = 0  # workers at present
    stopped: bool = False  # whether the sweep was asked to stop before its end

    @property
    def runs_per_s(self) -> float:
        """Runs stored by this sweep for each second of it."""
        return self.computed / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def left_s(self) -> float | None:
        """Expected time to the end [s]; None before anything is computed."""
        given_up = sum(shard.runs for shard in self.poison)
        return (self.runs - self.done - given_up) / self.runs_per_s if self.computed else None

    def note(self, computed: Computed) -> None:
        """Count a shard that was stored."""
        self.done += computed.shard.runs
        self.computed += computed.shard.runs
        self.shards += 1
        self.failed += computed.failed
        self.first_error = self.first_error or computed.first_error
        self.worker_seconds += computed.seconds
        self.worker_cpu_seconds += computed.cpu_s


class Sizes:
    """Runs of the next shard: `fixed`, or `SHARD_S` long and fewer at the end."""

    def __init__(self, fixed: int | None = None) -> None:
        self._fixed = fixed
        self._recent: deque[tuple[int, float]] = deque(maxlen=WINDOW)
        self._largest = FIRST_RUNS

    def note(self, runs: int, seconds: float) -> None:
        """Note the duration of a shard [s]."""
        self._recent.append((runs, seconds))

    def next(self, left: int, workers: int) -> int:
        """Return the size of the next shard for the remaining runs and the workers."""
        if self._fixed is not None:
            return self._fixed
        seconds = sum(each for _, each in self._recent)
        if seconds <= 0.0:
            return FIRST_RUNS
        per_s = sum(runs for runs, _ in self._recent) / seconds
        fair = left // (2 * max(workers, 1))
        wanted = min(SHARD_S * per_s, max(fair, SHORTEST_S * per_s), GROWTH * self._largest)
        size = max(1, round(wanted))
        self._largest = max(self._largest, size)
        return size


def sweep(
    plan: Plan,
    store: Store,
    there: Sequence[Shard],
    pool: AnyPool,
    *,
    sizes: Sizes,
    is_stopped: Callable[[], bool] = lambda: False,
    on_progress: Callable[[Progress], None] = lambda _progress: None,
    clock: Callable[[], float] = time.monotonic,
) -> Progress:
    """Compute and store the runs of a study that are not `there`; once `is_stopped`, only finish the current shards.

    Raise FileError if a shard cannot be stored; UnavailableError if no worker is left, or none can compute anything.
    """
    cutter = Cutter(there, plan.runs)
    progress = Progress(runs=plan.runs, done=sum(shard.runs for shard in there))
    again: deque[Shard] = deque()
    attempts: dict[Shard, int] = {}
    began_s = clock()

    def note(outcome: Outcome) -> None:
        shard: Shard = outcome.item
        if outcome.error is None:
            store.write(shard, outcome.value.content)
            sizes.note(shard.runs, outcome.value.seconds)
            progress.note(outcome.value)
            return
        progress.lost_workers += 1
        attempts[shard] = attempts.get(shard, 0) + 1
        reason = str(outcome.error) if isinstance(outcome.error, HapticnetError) else in_words(outcome.error)
        is_final = isinstance(outcome.error, EndedError) and outcome.error.final
        if attempts[shard] < ATTEMPTS and not is_final:
            again.append(shard)
            return
        progress.poison.append(shard)
        progress.first_reason = progress.first_reason or reason
        if len(progress.poison) >= HOPELESS and not progress.computed:
            raise UnavailableError(f"no shard can be computed: {reason}")

    try:
        while True:
            if not progress.stopped and is_stopped():
                progress.stopped = True
                pool.drop_waiting()
            while not progress.stopped and pool.room > 0:
                shard = again.popleft() if again else cutter.cut(sizes.next(cutter.left, pool.workers))
                if shard is None:
                    break
                pool.submit(shard)
            if not pool.in_hand and (progress.stopped or not (again or cutter.left)):
                return progress
            for outcome in pool.outcomes(POLL_S):
                note(outcome)
            progress.seconds, progress.workers = clock() - began_s, pool.workers
            on_progress(progress)
    except (FileError, UnavailableError) as error:
        kept = f"{progress.done:,} of {plan.runs:,} runs are kept; run the same command again to continue"
        raise type(error)(f"{error}; {kept}") from error
    finally:
        progress.seconds = clock() - began_s
