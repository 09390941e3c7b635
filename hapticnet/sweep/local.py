"""Workers on this machine: one process each, so that it is known which shard a killed one was at."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from hapticnet.checks import check_integer
from hapticnet.errors import in_words
from hapticnet.experiment.workers import MOST_JOBS, end_with_parent
from hapticnet.runtime.processes import safe_path
from hapticnet.sweep.grid import Shard
from hapticnet.sweep.pool import Broken, Computed, Outcome
from hapticnet.sweep.runs import Plan, Runner
from hapticnet.sweep.work import compute

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

IN_HAND: Final = 2
"""Shards that a worker has: the one it computes, and the next, so that it never waits."""


class LocalPool:
    """Processes on this machine; see `pool.Pool`.

    Each is a `ProcessPoolExecutor` of one process: when a process is killed, its executor tells, and no other shard is
    touched. A new executor takes its place.

    Raises
    ------
    SettingsError
        If the number of workers is out of range.
    """

    def __init__(self, plan: Plan, workers: int) -> None:
        check_integer("workers", workers, 1, MOST_JOBS)
        self._workers = [_Worker(plan) for _ in range(workers)]

    @property
    def workers(self) -> int:
        """Number of workers."""
        return len(self._workers)

    @property
    def in_hand(self) -> int:
        """Number of shards it was given and has not returned."""
        return sum(len(worker.shards) for worker in self._workers)

    @property
    def room(self) -> int:
        """How many more shards it should be given now."""
        return IN_HAND * self.workers - self.in_hand

    def submit(self, shard: Shard) -> None:
        """Let the worker that has least compute a shard."""
        min(self._workers, key=lambda worker: len(worker.shards)).submit(shard)

    def outcomes(self, timeout_s: float) -> list[Outcome]:
        """Wait until something is finished, at most so long, and return it."""
        wait([future for each in self._workers for _, future in each.shards], timeout_s, FIRST_COMPLETED)
        return [outcome for worker in self._workers for outcome in worker.outcomes()]

    def drop_waiting(self) -> None:
        """Take back the shards that nobody computes yet."""
        for worker in self._workers:
            worker.drop_waiting()

    def close(self) -> None:
        """End the workers at once."""
        for worker in self._workers:
            worker.close()


class _Worker:
    """One process, and its shards in the order in which it computes them."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._pool: ProcessPoolExecutor | None = None
        self._processes: set[BaseProcess] = set()
        self.shards: deque[tuple[Shard, Future[Computed]]] = deque()

    def submit(self, shard: Shard) -> None:
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            with safe_path():
                self._pool = ProcessPoolExecutor(1, context, initializer=_begin, initargs=(self._plan, os.getpid()))
        others = set(multiprocessing.active_children())
        try:
            with safe_path(), _sigint_blocked():  # a process that is started here inherits it: Ctrl-C is for this one
                self.shards.append((shard, self._pool.submit(_compute, shard)))
        except BrokenProcessPool:  # it was killed with nothing to do, so no shard is to blame
            self.close()
            self.submit(shard)
            return
        self._processes |= set(multiprocessing.active_children()) - others

    def outcomes(self) -> list[Outcome]:
        """Return what is finished, and begin again with what a killed process had not begun."""
        found: list[Outcome] = []
        again: list[Shard] = []
        while self.shards and self.shards[0][1].done():
            shard, future = self.shards.popleft()
            try:
                found.append(future.result())
            except BrokenProcessPool:
                # It computed the first of them; the others waited.
                found.append(Broken(shard, "its worker process ended unexpectedly, perhaps for lack of memory"))
                again = [waiting for waiting, _ in self.shards]
                self.shards.clear()
                self.close()
            except Exception as error:
                found.append(Broken(shard, in_words(error)))
        for shard in again:
            self.submit(shard)
        return found

    def drop_waiting(self) -> None:
        """Forget all but the first. The process may begin with the second one before it is ended."""
        while len(self.shards) > 1:
            self.shards.pop()

    def close(self) -> None:
        pool, self._pool = self._pool, None
        for process in self._processes:
            process.kill()
        self._processes.clear()
        if pool is not None:
            pool.shutdown()


_plan: Plan | None = None
_runner: Runner | None = None


def _begin(plan: Plan, parent: int) -> None:
    global _plan, _runner
    _plan, _runner = plan, plan.runner()
    end_with_parent(parent)


def _compute(shard: Shard) -> Computed:
    assert _plan is not None and _runner is not None  # noqa: S101, PT018 - `_begin` ran before
    return compute(_plan, _runner, shard)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
