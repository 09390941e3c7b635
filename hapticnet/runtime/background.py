"""Threads for work that must not delay a sample: output to terminals and disks."""

import os
import threading
from collections.abc import Callable
from contextlib import suppress


def start_background(work: Callable[[], None], name: str) -> threading.Thread:
    """Start a daemon thread at normal priority; it does not keep the process from ending.

    A thread inherits the scheduling of the one that starts it. Under SCHED_FIFO it would compete with the loop.
    """

    def body() -> None:
        with suppress(AttributeError, OSError):  # not on Linux, or not permitted
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        work()

    thread = threading.Thread(target=body, name=name, daemon=True)
    thread.start()
    return thread
