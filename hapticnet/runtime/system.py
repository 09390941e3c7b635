"""Services of the operating system: time, random numbers, threads, real-time scheduling, an event loop."""

import gc
import os
import secrets
import sys
import threading
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

if TYPE_CHECKING:
    import asyncio


def now_us() -> int:
    """Return CLOCK_MONOTONIC in whole microseconds."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000


def waited_us() -> int:
    """Return the total time [µs] that this thread has waited for a processor; 0 if unknown."""
    try:
        # Linux, Documentation/scheduler/sched-stats.rst: time on a processor, time on a run queue [ns], time slices.
        return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) // 1000
    except (OSError, IndexError, ValueError):
        return 0


class SystemEntropy:
    """The operating system's random numbers. Satisfies `protocol.settings.Entropy`."""

    def integers(self, low: int, high: int, /) -> int:
        """Return a whole number from `low` to `high` - 1."""
        return low + secrets.randbelow(high - low)


def start_background(work: Callable[[], None], name: str) -> threading.Thread:
    """Start a daemon thread at normal priority: under SCHED_FIFO, which it inherits, it would compete with the loop."""

    def body() -> None:
        with suppress(AttributeError, OSError):  # not on Linux, or not permitted
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        work()

    thread = threading.Thread(target=body, name=name, daemon=True)
    thread.start()
    return thread


Result = TypeVar("Result")
FIFO_PRIORITY: Final = 10  # a low real-time priority: above all ordinary processes, below the kernel's threads
OTHER: Final = "SCHED_OTHER"


def run(main: Coroutine[Any, Any, Result]) -> Result:
    """Run a coroutine on uvloop, or on asyncio's own loop if uvloop is not installed."""
    import asyncio

    with asyncio.Runner(loop_factory=loop_factory()) as runner:
        return runner.run(main)


def loop_factory() -> "Callable[[], asyncio.AbstractEventLoop] | None":
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
    """Return the scheduling of this process, described like by `prefer_realtime`."""
    if sys.platform.startswith("linux") and os.sched_getscheduler(0) == os.SCHED_FIFO:
        return f"SCHED_FIFO {os.sched_getparam(0).sched_priority}"
    return OTHER


def policy(scheduling: str) -> str:
    """Return the first words of what `prefer_realtime` returned, without the reason."""
    return scheduling.partition(" (")[0]
