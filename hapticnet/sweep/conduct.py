"""Conduct a sweep: cut what is missing into shards, give them to workers, and store each as it comes."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

from hapticnet.errors import FileError, UnavailableError
from hapticnet.sweep.folder import Folder
from hapticnet.sweep.grid import Cutter, Shard, gaps
from hapticnet.sweep.pool import Broken, Computed, Pool
from hapticnet.sweep.runs import Plan, runs_of

SHARD_S: Final = 3.0
"""Duration of a shard [s]: long beside what it costs to send and to store one, short beside a patience."""

SHORTEST_S: Final = 0.3
"""Duration of the last shards [s], which are short so that all workers end at about the same time."""

FIRST_RUNS: Final = 2
"""Runs in a shard before it is known how long a run takes."""

GROWTH: Final = 8
"""Most times by which shards grow from one to the next: the first ones include the start of a worker."""

WINDOW: Final = 8
POLL_S: Final = 0.25
ATTEMPTS: Final = 3
"""How often a shard is tried whose worker ends."""

HOPELESS: Final = 5
"""So many shards that cannot be computed, and none that can, end a sweep."""


@dataclass(slots=True)
class Progress:
    """How far a sweep is.

    Attributes
    ----------
    runs, done
        Runs of the study, and those that are stored.
    computed
        Runs that were computed and stored by this sweep.
    shards
        Shards that this sweep stored.
    failed, first_error
        Runs among those computed that have an error in the place of figures, and the first error.
    broken
        How often a worker ended while it computed.
    poison
        Shards that were given up.
    worker_s, worker_cpu_s
        Sum of the shards' durations and processor times [s].
    seconds
        Duration of this sweep so far [s].
    workers
        Workers at present.
    stopped
        Whether the sweep was asked to stop before its end.
    """

    runs: int
    done: int = 0
    computed: int = 0
    shards: int = 0
    failed: int = 0
    first_error: str | None = None
    broken: int = 0
    poison: list[Shard] = field(default_factory=list)
    worker_s: float = 0.0
    worker_cpu_s: float = 0.0
    seconds: float = 0.0
    workers: int = 0
    stopped: bool = False

    @property
    def runs_per_s(self) -> float:
        """Runs stored by this sweep for each second of it."""
        return self.computed / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def left_s(self) -> float | None:
        """Expected time to the end [s]; None before anything is computed."""
        given_up = sum(shard.runs for shard in self.poison)
        return (self.runs - self.done - given_up) / self.runs_per_s if self.computed else None


class Sizes:
    """How many runs the next shard has.

    Parameters
    ----------
    fixed
        Always so many; None: as many as take `SHARD_S`, and fewer toward the end.
    sharing
        Otherwise a multiple of this; see `runs.Plan.sharing`.
    """

    def __init__(self, fixed: int | None = None, sharing: int = 1) -> None:
        self._fixed = fixed
        self._sharing = sharing
        self._recent: deque[tuple[int, float]] = deque(maxlen=WINDOW)
        self._largest = FIRST_RUNS

    def note(self, runs: int, seconds: float) -> None:
        """Take in how long a shard took [s]."""
        self._recent.append((runs, seconds))

    def next(self, left: int, workers: int) -> int:
        """Return the size of the next shard while so many runs are left for so many workers."""
        if self._fixed is not None:
            return self._fixed
        seconds = sum(each for _, each in self._recent)
        if seconds <= 0.0:
            return self._rounded(FIRST_RUNS)
        per_s = sum(runs for runs, _ in self._recent) / seconds
        fair = left // (2 * max(workers, 1))
        wanted = min(SHARD_S * per_s, max(fair, SHORTEST_S * per_s), GROWTH * self._largest)
        size = self._rounded(wanted)
        self._largest = max(self._largest, size)
        return size

    def _rounded(self, runs: float) -> int:
        return max(1, round(runs / self._sharing)) * self._sharing


def conduct(
    plan: Plan,
    folder: Folder,
    there: Sequence[Shard],
    pool: Pool,
    *,
    sizes: Sizes,
    is_stopped: Callable[[], bool] = lambda: False,
    on_progress: Callable[[Progress], None] = lambda _progress: None,
    clock: Callable[[], float] = time.monotonic,
) -> Progress:
    """Compute and store the missing runs of a study.

    Parameters
    ----------
    there
        Shards that are stored already.
    is_stopped
        Asked a few times a second; once true, the shards in hand are finished and nothing else is begun.
    on_progress
        Called whenever something may have changed.

    Raises
    ------
    FileError
        If a shard cannot be stored. All that were stored before are kept.
    UnavailableError
        If the workers are gone, or none of them can compute anything.
    """
    runs = runs_of(plan)
    cutter = Cutter(gaps(there, runs))
    progress = Progress(runs=runs, done=sum(shard.runs for shard in there))
    again: deque[Shard] = deque()
    attempts: dict[Shard, int] = {}
    began_s = clock()

    def note(outcome: Computed | Broken) -> None:
        shard = outcome.shard
        if isinstance(outcome, Computed):
            folder.write(shard, outcome.content)
            sizes.note(shard.runs, outcome.seconds)
            progress.done += shard.runs
            progress.computed += shard.runs
            progress.shards += 1
            progress.failed += outcome.failed
            progress.first_error = progress.first_error or outcome.first_error
            progress.worker_s += outcome.seconds
            progress.worker_cpu_s += outcome.cpu_s
            return
        progress.broken += 1
        attempts[shard] = attempts.get(shard, 0) + 1
        if attempts[shard] < ATTEMPTS and not outcome.final:
            again.append(shard)
            return
        progress.poison.append(shard)
        folder.mark(shard, outcome.reason)
        if len(progress.poison) >= HOPELESS and not progress.computed:
            raise UnavailableError(f"no shard can be computed: {outcome.reason}")

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
        kept = f"{progress.done:,} of {runs:,} runs are kept; run the same command again to go on"
        raise type(error)(f"{error}; {kept}") from error
    finally:
        progress.seconds = clock() - began_s
