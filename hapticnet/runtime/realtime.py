"""Punctual execution: a libuv event loop if installed, and real-time scheduling if permitted."""

import asyncio
import gc
import os
import sys
from collections.abc import Callable, Coroutine
from typing import Any, Final, TypeVar

Result = TypeVar("Result")

FIFO_PRIORITY: Final = 10
"""A low real-time priority: above all ordinary processes, below the kernel's threads."""

OTHER: Final = "SCHED_OTHER"


def run(main: Coroutine[Any, Any, Result]) -> Result:
    """Run a coroutine on uvloop, or on asyncio's own loop if uvloop is not installed."""
    with asyncio.Runner(loop_factory=loop_factory()) as runner:
        return runner.run(main)


def loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Return the factory of the best available event loop; None for asyncio's own."""
    try:
        import uvloop
    except ImportError:
        return None
    return uvloop.new_event_loop


def prefer_realtime() -> str:
    """Request SCHED_FIFO and tune the garbage collector; return a description of the granted scheduling."""
    # Objects allocated so far are permanent: scanning them at every collection would only delay ticks.
    gc.collect()
    gc.freeze()
    if not sys.platform.startswith("linux"):
        return OTHER
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except PermissionError:
        return f"{OTHER} (SCHED_FIFO refused: it needs root or CAP_SYS_NICE, and in a container a real-time budget)"
    except OSError as error:
        return f"{OTHER} (SCHED_FIFO refused: {error.strerror})"
    return f"SCHED_FIFO {FIFO_PRIORITY}"


def scheduling() -> str:
    """Return the scheduling of this process, described as by `prefer_realtime`."""
    if sys.platform.startswith("linux") and os.sched_getscheduler(0) == os.SCHED_FIFO:
        return f"SCHED_FIFO {os.sched_getparam(0).sched_priority}"
    return OTHER


def policy(scheduling: str) -> str:
    """Return the first words of what `prefer_realtime` returned, without the reason."""
    return scheduling.partition(" (")[0]
