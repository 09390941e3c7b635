"""The one pool of worker processes: items go in, results come out, and a killed process costs only one item."""

import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from hapticnet.checks import check_integer
from hapticnet.errors import UnavailableError, in_words
from hapticnet.runtime.processes import safe_path

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

MOST_JOBS: Final = 256
PARENT_CHECK_S: Final = 0.5
IN_HAND: Final = 2  # items that a worker has: the one it computes, and the next, so that it never waits
Function: TypeAlias = Callable[[Any, Any], Any]  # called with the shared data and an item
OrderedMap: TypeAlias = Callable[[Function, Iterable[Any]], Iterator[Any]]  # the same over items, in order


class Outcome(NamedTuple):
    """The outcome of an item: its value, or the error of its function; `EndedError` if its process ended."""

    item: Any
    value: Any
    error: BaseException | None


class EndedError(UnavailableError):
    """A worker process was killed, or ended itself, while it computed an item; `final` if no tries are left."""

    def __init__(self, text: str, *, final: bool = False) -> None:
        super().__init__(text)
        self.final = final


class Pool:
    """Processes that compute `function(shared, item)`. A process that ends is replaced when there is work for it.

    With the method "fork", `shared` does not have to be picklable; "spawn" may also be used beside other threads.
    """

    def __init__(self, jobs: int, function: Function, shared: Any, *, method: str) -> None:
        check_integer("jobs", jobs, 1, MOST_JOBS)
        self.workers = jobs  # number of processes
        self._workers = [_Worker(function, shared, method) for _ in range(jobs)]

    @property
    def in_hand(self) -> int:
        """Number of submitted items without an outcome yet."""
        return sum(len(worker.items) for worker in self._workers)

    @property
    def room(self) -> int:
        """Number of further items to submit now."""
        return IN_HAND * self.workers - self.in_hand

    def submit(self, item: Any) -> None:
        """Let the least busy process compute an item."""
        min(self._workers, key=lambda worker: len(worker.items)).submit(item)

    def outcomes(self, timeout_s: float | None = None) -> list[Outcome]:
        """Wait until something is finished, at most this long, and return it."""
        busy = {worker.connection: worker for worker in self._workers if worker.items}
        ready = wait(list(busy), timeout_s) if busy else []
        return [busy[connection].receive() for connection in ready if isinstance(connection, Connection)]

    def drop_waiting(self) -> None:
        """Forget the items that no process computes yet. A process may still begin one before it is ended."""
        for worker in self._workers:
            while len(worker.items) > 1:
                worker.items.pop()

    def close(self) -> None:
        """End the processes at once."""
        for worker in self._workers:
            worker.end()


class _Worker:
    def __init__(self, function: Function, shared: Any, method: str) -> None:
        self._call = function, shared
        self._context = multiprocessing.get_context(method)
        self._process: BaseProcess | None = None
        self.connection: Connection
        self.items: deque[Any] = deque()

    def submit(self, item: Any) -> None:
        if self._process is None:
            self._start()
        self.items.append(item)
        try:
            self.connection.send(item)
        except OSError:
            if len(self.items) == 1:  # it was killed with nothing to do, so no item is to blame
                self._restart()

    def receive(self) -> Outcome:
        """Return the outcome of the first item; begin again with the others if the process has ended."""
        try:
            value, error = self.connection.recv()
        except (EOFError, OSError):
            reason = "a worker process ended unexpectedly, perhaps for lack of memory"
            outcome = Outcome(self.items.popleft(), None, EndedError(reason))
            self._restart()
            return outcome
        except Exception as problem:  # a user's error that cannot be unpickled
            value, error = None, problem
        return Outcome(self.items.popleft(), value, error)

    def end(self) -> None:
        if self._process is not None:
            self._process.kill()  # it may have inherited a handler that ignores SIGTERM
            self._process.join()
            self._process.close()
            self.connection.close()
            self._process = None

    def _restart(self) -> None:
        self.end()
        items = list(self.items)
        self.items.clear()
        for item in items:
            self.submit(item)

    def _start(self) -> None:
        self.connection, there = self._context.Pipe()
        with safe_path(), _sigint_blocked():  # the child inherits it: Ctrl-C is for this process
            make: Any = self._context
            self._process = make.Process(target=_serve, args=(there, *self._call, os.getpid()))
            self._process.start()
        there.close()


def _serve(connection: Connection, function: Function, shared: Any, parent: int) -> None:
    end_with_parent(parent)
    while True:
        try:
            item = connection.recv()
        except EOFError:
            return
        answer: tuple[Any, BaseException | None]
        try:
            answer = function(shared, item), None
        except BaseException as error:
            error.add_note("".join(traceback.format_exception(error)))
            answer = None, error
        try:
            connection.send(answer)
        except Exception as error:  # it cannot be pickled
            connection.send((None, RuntimeError(in_words(answer[1] or error))))


def end_with_parent(parent: int) -> None:
    """End this process when the process with this number is no longer its parent; a killed parent cannot end it."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def workers(jobs: int, shared: Any) -> Iterator[OrderedMap]:
    """Yield an `OrderedMap` that runs in `jobs` processes; with 1 lazily in this one. Or `EndedError`.

    On Linux the processes are forked, so `shared` may hold objects that cannot be pickled, such as users' codecs.
    """
    if jobs == 1:
        yield lambda function, items: map(partial(function, shared), items)
        return
    pool = Pool(jobs, _call, shared, method="fork" if sys.platform == "linux" else "spawn")
    try:
        yield partial(_in_order, pool)
    finally:  # also at Ctrl-C: later results of the processes are useless
        pool.close()


def _in_order(pool: Pool, function: Function, items: Iterable[Any]) -> Iterator[Any]:
    numbered, more = enumerate(items), True
    found: dict[int, Any] = {}
    wanted = 0
    while True:
        while more and pool.room > 0:
            number_and_item = next(numbered, None)
            if number_and_item is None:
                more = False
            else:
                pool.submit((function, *number_and_item))
        if not pool.in_hand:
            return
        for outcome in pool.outcomes():
            if outcome.error is not None:
                raise outcome.error
            found[outcome.item[1]] = outcome.value
        while wanted in found:
            yield found.pop(wanted)
            wanted += 1


def _call(shared: Any, call: tuple[Function, int, Any]) -> Any:
    function, _, item = call
    return function(shared, item)


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
