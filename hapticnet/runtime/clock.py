"""The one clock: monotonic microseconds, the same that timerfd counts in."""

import time


def now_us() -> int:
    """Return CLOCK_MONOTONIC in whole microseconds."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
