"""Timers that wake an event loop to the microsecond.

The loops' own timers are a millisecond coarse (uvloop) or late (asyncio); a timerfd that the loop watches like a socket
is as punctual as a C program sleeping with clock_nanosleep. bench/measure/loop.py measures both.
"""

import asyncio
import ctypes
import os
import struct
from collections.abc import Callable
from typing import Final

from hapticnet.errors import UnavailableError
from hapticnet.protocol.stats import Distribution
from hapticnet.runtime.clock import now_us

# <time.h>, <sys/timerfd.h> and <fcntl.h> of Linux; `os` has timerfd only from Python 3.13 on.
_CLOCK_MONOTONIC: Final = 1
_TFD_NONBLOCK: Final = 0o4000
_TFD_CLOEXEC: Final = 0o2000000
_TFD_TIMER_ABSTIME: Final = 1
_EXPIRATIONS: Final = struct.Struct("=Q")
_ITIMERSPEC: Final = struct.Struct("=qqqq")  # interval s, ns; first expiry s, ns


class _TimerFd:
    """A timerfd on CLOCK_MONOTONIC."""

    def __init__(self) -> None:
        try:
            self._libc = ctypes.CDLL(None, use_errno=True)
            create = self._libc.timerfd_create
        except (OSError, AttributeError) as error:
            raise UnavailableError("this system has no timerfd; hapticnet's processes run on Linux") from error
        self.fd = create(_CLOCK_MONOTONIC, _TFD_NONBLOCK | _TFD_CLOEXEC)
        if self.fd < 0:
            raise UnavailableError(f"no timer to be had: {os.strerror(ctypes.get_errno())}")

    def set(self, first_us: int, interval_us: int) -> None:
        """Expire at `first_us` on the monotonic clock (0: never), then every `interval_us` (0: once)."""
        spec = _ITIMERSPEC.pack(*divmod(interval_us * 1000, 10**9), *divmod(first_us * 1000, 10**9))
        if self._libc.timerfd_settime(self.fd, _TFD_TIMER_ABSTIME, spec, None) < 0:
            raise UnavailableError(f"the timer cannot be set: {os.strerror(ctypes.get_errno())}")

    def expirations(self) -> int:
        """Return how often it expired since the last call."""
        try:
            (count,) = _EXPIRATIONS.unpack(os.read(self.fd, 8))
        except BlockingIOError:
            return 0
        return int(count)


class Ticker:
    """Calls back at a fixed rate, and keeps account of how late.

    Attributes
    ----------
    lateness
        From the time a tick was due to its callback [µs].
    missed
        Ticks that were over before their turn came; they are not made up for.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, period_us: int, callback: Callable[[int], None]) -> None:
        self.lateness = Distribution()
        self.missed = 0
        self._loop = loop
        self._callback = callback
        self._timer = _TimerFd()
        self._period_us = period_us
        self._due_us = 0
        loop.add_reader(self._timer.fd, self._fire)
        self.set_period(period_us)

    def set_period(self, period_us: int) -> None:
        """Tick every `period_us` from now on."""
        self._period_us = period_us
        self._due_us = now_us()
        self._timer.set(self._due_us + period_us, period_us)

    @property
    def period_us(self) -> int:
        """The time between two ticks [µs]."""
        return self._period_us

    def stop(self) -> None:
        """Tick no more."""
        self._loop.remove_reader(self._timer.fd)
        os.close(self._timer.fd)

    def _fire(self) -> None:
        expirations = self._timer.expirations()
        if not expirations:
            return
        self._due_us += expirations * self._period_us
        now = now_us()
        # A loop may wake a microsecond early by its own rounding; a tick never happens before it is due.
        self.lateness.add(now - self._due_us + (expirations - 1) * self._period_us)
        self.missed += expirations - 1
        self._callback(max(now, self._due_us))


class Alarm:
    """Calls back once, at the time it was last set to."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._timer = _TimerFd()
        self._set_to_us: int | None = None
        loop.add_reader(self._timer.fd, self._fire)

    def set(self, at_us: int | None) -> None:
        """Ring at `at_us` on the monotonic clock, at once if that is past; None: not at all."""
        if at_us != self._set_to_us:
            self._set_to_us = at_us
            self._timer.set(0 if at_us is None else max(1, at_us), 0)

    def stop(self) -> None:
        """Ring no more."""
        self._loop.remove_reader(self._timer.fd)
        os.close(self._timer.fd)

    def _fire(self) -> None:
        if self._timer.expirations():
            self._set_to_us = None
            self._callback()
