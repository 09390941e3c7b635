"""Being run on time: an event loop on libuv where there is one, and the real-time scheduling class where allowed."""

import asyncio
import gc
import os
import sys
from collections.abc import Callable, Coroutine
from typing import Any, Final, TypeVar

Result = TypeVar("Result")

FIFO_PRIORITY: Final = 10
"""Low among real-time priorities: above every ordinary process, below the kernel's own threads."""

OTHER: Final = "SCHED_OTHER"


def run(main: Coroutine[Any, Any, Result]) -> Result:
    """Run a coroutine on uvloop, or on asyncio's own loop where uvloop is absent."""
    with asyncio.Runner(loop_factory=loop_factory()) as runner:
        return runner.run(main)


def loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Return what makes the best event loop there is; None for asyncio's own."""
    try:
        import uvloop
    except ImportError:
        return None
    return uvloop.new_event_loop


def prefer_realtime() -> str:
    """Ask for SCHED_FIFO and settle the garbage collector; return in words which scheduling was granted."""
    # What was allocated up to here stays: collecting it again and again would only cost ticks.
    gc.collect()
    gc.freeze()
    if not sys.platform.startswith("linux"):
        return OTHER
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except PermissionError:
        return f"{OTHER} (SCHED_FIFO refused: it takes root or CAP_SYS_NICE, and in a container a real-time budget)"
    except OSError as error:
        return f"{OTHER} (SCHED_FIFO refused: {error.strerror})"
    return f"SCHED_FIFO {FIFO_PRIORITY}"
