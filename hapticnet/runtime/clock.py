"""The one clock: monotonic microseconds, the same that timerfd counts in; and time that was lost to other processes."""

import time
from pathlib import Path


def now_us() -> int:
    """Return CLOCK_MONOTONIC in whole microseconds."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000


def waited_us() -> int:
    """Return how long [µs] this thread has waited for a processor in all; 0 if the system does not tell."""
    try:
        # Linux, Documentation/scheduler/sched-stats.rst: time on a processor, time on a run queue [ns], time slices.
        return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) // 1000
    except (OSError, IndexError, ValueError):
        return 0
