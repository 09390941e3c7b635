"""Waiting on an event loop: timers of microsecond accuracy, calls twice a second, and events.

The loops' own timers have a resolution of 1 ms (uvloop) or are late (asyncio). A timerfd that the loop watches like a
socket is as accurate as clock_nanosleep in C. bench/measure/real_time.py measures both.
"""

import asyncio
import ctypes
import os
import struct
from collections.abc import Callable
from typing import Final

from hapticnet.errors import UnavailableError
from hapticnet.protocol.stats import Distribution
from hapticnet.runtime.system import now_us

# From <time.h>, <sys/timerfd.h> and <fcntl.h> of Linux; `os` has timerfd since Python 3.13.
_CLOCK_MONOTONIC: Final = 1
_TFD_NONBLOCK: Final = 0o4000
_TFD_CLOEXEC: Final = 0o2000000
_TFD_TIMER_ABSTIME: Final = 1
_EXPIRATIONS: Final = struct.Struct("=Q")
_ITIMERSPEC: Final = struct.Struct("=qqqq")  # interval s, ns; first expiry s, ns
STATUS_INTERVAL_S: Final = 0.5


class _Timer:
    """A timerfd on CLOCK_MONOTONIC that calls `_fire` on an event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        try:
            self._libc = ctypes.CDLL(None, use_errno=True)
            create = self._libc.timerfd_create
        except (OSError, AttributeError) as error:
            raise UnavailableError("this system has no timerfd; hapticnet's processes run on Linux") from error
        self._fd = create(_CLOCK_MONOTONIC, _TFD_NONBLOCK | _TFD_CLOEXEC)
        if self._fd < 0:
            raise UnavailableError(f"cannot create a timer: {os.strerror(ctypes.get_errno())}")
        self._loop = loop
        loop.add_reader(self._fd, self._fire)

    def stop(self) -> None:
        """Stop the calls."""
        self._loop.remove_reader(self._fd)
        os.close(self._fd)

    def _fire(self) -> None:
        raise NotImplementedError

    def _set_timer(self, first_us: int, interval_us: int) -> None:
        """Expire at `first_us` on the monotonic clock (0: never), then every `interval_us` (0: once)."""
        spec = _ITIMERSPEC.pack(*divmod(interval_us * 1000, 10**9), *divmod(first_us * 1000, 10**9))
        if self._libc.timerfd_settime(self._fd, _TFD_TIMER_ABSTIME, spec, None) < 0:
            raise UnavailableError(f"cannot set the timer: {os.strerror(ctypes.get_errno())}")

    def _expirations(self) -> int:
        try:
            (count,) = _EXPIRATIONS.unpack(os.read(self._fd, 8))
        except BlockingIOError:
            return 0
        return int(count)


class Ticker(_Timer):
    """Call a function at a fixed rate and record how late the calls are."""

    def __init__(self, loop: asyncio.AbstractEventLoop, period_us: int, callback: Callable[[int], None]) -> None:
        self.lateness = Distribution()  # time [µs] from when a tick was due to its call
        self.missed = 0  # number of ticks skipped because the next was already due
        self._callback = callback
        super().__init__(loop)
        self.period_us = period_us  # time between two ticks [µs]
        self._due_us = now_us()
        self._set_timer(self._due_us + period_us, period_us)

    def _fire(self) -> None:
        expirations = self._expirations()
        if not expirations:
            return
        self._due_us += expirations * self.period_us
        now = now_us()
        # The loop's rounding may wake it a microsecond early; a tick must not come before it is due.
        self.lateness.add(now - self._due_us + (expirations - 1) * self.period_us)
        self.missed += expirations - 1
        self._callback(max(now, self._due_us))


class Alarm(_Timer):
    """Call a function once, at the time set last."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._callback = callback
        self._set_to_us: int | None = None
        super().__init__(loop)

    def set(self, at_us: int | None) -> None:
        """Set the time `at_us` on the monotonic clock (the past: at once; None: never)."""
        if at_us != self._set_to_us:
            self._set_to_us = at_us
            self._set_timer(0 if at_us is None else max(1, at_us), 0)

    def _fire(self) -> None:
        if self._expirations():
            self._set_to_us = None
            self._callback()


async def until(event: asyncio.Event, timeout_s: float | None) -> bool:
    """Wait for an event for at most `timeout_s` [s]; return whether it was set."""
    try:
        await asyncio.wait_for(event.wait(), timeout_s)
    except TimeoutError:
        return False
    return True


async def either(one: asyncio.Event, other: asyncio.Event, timeout_s: float | None) -> bool:
    """Wait for either of two events for at most `timeout_s` [s]; return whether one was set."""
    waits = [asyncio.ensure_future(event.wait()) for event in (one, other)]
    try:
        done, _ = await asyncio.wait(waits, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()
    return bool(done)


class Repeating:
    """Call a function every `STATUS_INTERVAL_S` until cancelled."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._handle = loop.call_later(STATUS_INTERVAL_S, self._fire)

    def cancel(self) -> None:
        """Stop the calls."""
        self._handle.cancel()

    def _fire(self) -> None:
        self._callback()
        self._handle = self._loop.call_later(STATUS_INTERVAL_S, self._fire)
