"""A map over several processes, in order, with large inputs that each process gets only once."""

import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Any, Final, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.errors import UnavailableError

MOST_JOBS: Final = 256

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
    pool = ProcessPoolExecutor(jobs, context, initializer=_keep, initargs=(shared,))
    try:
        yield lambda function, items: pool.map(partial(_call, function), items)
    except BrokenProcessPool as error:
        raise UnavailableError("a worker process ended unexpectedly, perhaps for lack of memory; try fewer") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _keep(shared: Any) -> None:
    global _shared
    _shared = shared


def _call(function: Callable[[Any, Any], Any], item: Any) -> Any:
    return function(_shared, item)
