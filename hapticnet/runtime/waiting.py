"""Waiting on an event loop: for signals, for events, and for the next time something is due."""

import asyncio
import signal
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from hapticnet.interrupts import TakesSignals
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.rescue import Rescue

STATUS_INTERVAL_S: Final = 0.5


class SignalHandler(TakesSignals):
    """Call a function on an event loop at a signal. Unlike a handler of the loop, it stays when the loop is closed."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback

    def take(self, *numbers: int) -> None:
        """Handle these signals from now on."""
        for number in numbers:
            signal.signal(number, self)
            signal.siginterrupt(number, False)

    def __call__(self, _number: int, _frame: object) -> None:
        """Call the function soon; called by Python in the middle of what the main thread does."""
        with suppress(RuntimeError):  # the loop is closed: it is too late for this
            self._loop.call_soon_threadsafe(self._callback)


class _StopHandler(SignalHandler):
    """Let `Rescue` watch from the first signal on, too."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None], rescue: Rescue | None) -> None:
        super().__init__(loop, callback)
        self._reports = rescue is not None
        self._rescue = rescue or Rescue()

    def __call__(self, number: int, frame: object) -> None:
        if self._loop.is_closed() and not self._reports:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
            signal.raise_signal(number)
            return
        self._rescue.signalled(self._loop)
        super().__call__(number, frame)


def stop_on_signals(
    loop: asyncio.AbstractEventLoop, rescue: Rescue | None = None, again: asyncio.Event | None = None
) -> asyncio.Event:
    """Return an event that SIGINT and SIGTERM set; each signal after the first sets `again`.

    A loop that is stuck, perhaps in a method of a user's class that does not return, cannot set it: `Rescue` ends it
    then. A process with a `rescue` has a report to deliver, so once its loop is closed, signals change nothing any
    more, but `rescue` still ends what does not return. In any other, signals then do what they do by default.
    """
    stop = asyncio.Event()

    def note() -> None:
        if stop.is_set() and again is not None:
            again.set()
        stop.set()

    _StopHandler(loop, note, rescue).take(signal.SIGINT, signal.SIGTERM)
    return stop


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
    """Call a function, and check for overload, every `STATUS_INTERVAL_S` until cancelled."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None], overload: Overload | None = None
    ) -> None:
        self._loop = loop
        self._callback = callback
        self._overload = overload
        self._handle = loop.call_later(STATUS_INTERVAL_S, self._fire)

    def cancel(self) -> None:
        """Stop the calls."""
        self._handle.cancel()

    def _fire(self) -> None:
        self._callback()
        if self._overload is not None:
            self._overload.check(now_us())
        self._handle = self._loop.call_later(STATUS_INTERVAL_S, self._fire)
