"""Waiting on an event loop: for signals, for events, and for the next time something is due."""

import asyncio
import signal
from collections.abc import Callable
from typing import Final

from hapticnet.runtime.clock import now_us
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.rescue import Rescue

STATUS_INTERVAL_S: Final = 0.5


def stop_on_signals(loop: asyncio.AbstractEventLoop, rescue: Rescue | None = None) -> asyncio.Event:
    """Return an event that SIGINT and SIGTERM set.

    A loop that is stuck, perhaps in a method of a user's class that does not return, cannot set it: `Rescue` ends it
    then. Once the loop is closed, signals do what they do by default.
    """
    stop = asyncio.Event()
    rescue = rescue or Rescue()

    def insist(number: int, _: object) -> None:
        if loop.is_closed():  # uvloop leaves this handler behind
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
            signal.raise_signal(number)
            return
        rescue.signalled(loop)

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
        signal.signal(number, insist)  # Python calls it in the middle of what the loop does; the loop then sets `stop`
        signal.siginterrupt(number, False)  # as the loop itself does
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
