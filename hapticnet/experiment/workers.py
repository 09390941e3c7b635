"""A map over several processes, in order, with large inputs that each process gets only once."""

import multiprocessing
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Any, Final, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.errors import UnavailableError
from hapticnet.runtime.processes import safe_path

MOST_JOBS: Final = 256
PARENT_CHECK_S: Final = 0.5

OrderedMap: TypeAlias = Callable[[Callable[[Any, Any], Any], Iterable[Any]], Iterator[Any]]
"""Called with a function and items; returns `function(shared, item)` for each item, in the order of the items."""

_shared: Any = None


@contextmanager
def workers(jobs: int, shared: Any) -> Iterator[OrderedMap]:
    """Yield an `OrderedMap` that runs in `jobs` processes; with 1 it runs lazily in this one.

    Parameters
    ----------
    shared
        First argument of every call. On Linux it need not be picklable, nor known to any module: the processes are
        forked. This is how codecs that the user loaded from a file get there.

    Raises
    ------
    SettingsError
        If `jobs` is outside 1 to `MOST_JOBS`.
    UnavailableError
        If a process ends unexpectedly.
    """
    check_parameter("jobs", jobs, 1, MOST_JOBS)
    if jobs == 1:
        yield lambda function, items: map(partial(function, shared), items)
        return
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    others = set(multiprocessing.active_children())
    with safe_path():
        pool = ProcessPoolExecutor(jobs, context, initializer=_keep, initargs=(shared, os.getpid()))
    try:
        yield partial(_in_order, pool)
    except BaseException as error:
        # Such as Ctrl-C: what the processes are at is of no use any more. Nothing is cancelled, because a pool that is
        # broken at that moment would fail on a cancelled future and never end. They are killed, because they may have
        # inherited a handler that ignores SIGTERM.
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        if isinstance(error, BrokenProcessPool):
            raise UnavailableError(
                "a worker process ended unexpectedly, perhaps for lack of memory; try fewer"
            ) from error
        raise
    finally:
        pool.shutdown()


def _in_order(pool: ProcessPoolExecutor, function: Callable[[Any, Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    with safe_path():
        futures = deque(pool.submit(_call, function, item) for item in items)
    while futures:
        yield futures.popleft().result()


def _keep(shared: Any, parent: int) -> None:
    global _shared
    _shared = shared
    end_with_parent(parent)


def end_with_parent(parent: int) -> None:
    """End this process when the process with this number is no longer its parent; a killed parent cannot tell."""
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(PARENT_CHECK_S)
    os._exit(1)


def _call(function: Callable[[Any, Any], Any], item: Any) -> Any:
    return function(_shared, item)
