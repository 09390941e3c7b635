"""SIGINT and SIGTERM: end a run in order, even if it is stuck in code that does not return."""

import asyncio
import os
import signal
import sys
import sysconfig
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hapticnet.errors import RunError, UserCodeError
from hapticnet.interrupts import TakesSignals
from hapticnet.runtime.nonblocking_log import STDERR, Level, LogLine
from hapticnet.runtime.system import start_background

if TYPE_CHECKING:
    from types import FrameType


PATIENCE_S: Final = 2.0  # time [s] in which a running loop reacts
TRIES: Final = 3  # interruptions of code that does not return, before the process ends without it
CONCLUDE_S: Final = 10.0  # time [s] for work after the loop, such as ``close()`` of a user's object
_NOT_THE_USERS: Final = (str(Path(__file__).parents[1]) + os.sep, sysconfig.get_path("stdlib") + os.sep, "<frozen")


class Rescue:
    """Watch the loop from the first signal on: interrupt the code it is stuck in, and finally the process.

    A thread asks the loop for a sign of life. Without one for `PATIENCE_S`, the stuck code gets an
    exception, which is handled like any other of that code; a run then ends in order. Code that ignores this
    after `TRIES`, or that waits in C, is abandoned, and `deliver` is called in the thread. Code in C that keeps the
    interpreter's lock can only be killed.
    """

    def __init__(self, deliver: Callable[[], None] = lambda: None) -> None:
        self.faults: list[str] = []  # descriptions of code that did not return
        self._deliver = deliver
        self._thread: threading.Thread | None = None
        self._interrupts = False
        self._ended = threading.Event()

    def signalled(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to watch; called by the handler of a signal, in the main thread."""
        if self._interrupts:
            self._interrupts = False
            raise UserCodeError(self.faults[-1])
        if self._thread is None:
            self._thread = start_background(lambda: self._watch(loop), "rescue")

    def done(self) -> None:
        """Stop watching: everything has returned."""
        self._ended.set()

    def _watch(self, loop: asyncio.AbstractEventLoop) -> None:
        main = threading.main_thread().ident
        assert main is not None  # noqa: S101 - for the type checker: it has started
        while not self._ended.is_set():
            sign = threading.Event()
            try:
                loop.call_soon_threadsafe(sign.set)
            except RuntimeError:  # the loop is closed
                break
            if sign.wait(PATIENCE_S):
                self._ended.wait(0.1)
            elif self._ended.is_set() or loop.is_closed():  # it ended before the sign of life
                continue
            elif len(self.faults) < TRIES:
                self.faults.append(f"{place_of(main)} did not return within {PATIENCE_S:g} s")
                self._interrupts = True
                signal.pthread_kill(main, signal.SIGINT)
            else:
                self._give_up(main)
        if not self._ended.wait(CONCLUDE_S):
            self._give_up(main)

    def _give_up(self, main: int) -> None:
        self.faults.append(f"{place_of(main)} does not return")
        STDERR.line(LogLine(f"{self.faults[-1]}: ended without it", who="hapticnet", level=Level.ERROR), needed=True)
        with suppress(Exception):
            self._deliver()
        STDERR.drain()
        os._exit(RunError.exit_code)


def place_of(thread: int) -> str:
    """Return the place of a thread in words: the innermost line outside hapticnet and Python's library."""
    frame: FrameType | None = sys._current_frames().get(thread)
    while frame is not None and frame.f_code.co_filename.startswith(_NOT_THE_USERS):
        frame = frame.f_back
    if frame is None:
        return "the event loop"
    return f"{frame.f_code.co_qualname} ({Path(frame.f_code.co_filename).name}, line {frame.f_lineno})"


class SignalHandler(TakesSignals):
    """Call a function on an event loop at a signal. Unlike a loop's handler, it remains when the loop is closed."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback

    def take(self, *numbers: int) -> None:
        """Handle these signals from now on."""
        for number in numbers:
            signal.signal(number, self)
            signal.siginterrupt(number, False)

    def __call__(self, _number: int, _frame: object) -> None:
        """Call the function soon; called by Python in the middle of the main thread's work."""
        with suppress(RuntimeError):  # the loop is closed: too late
            self._loop.call_soon_threadsafe(self._callback)


class _StopHandler(SignalHandler):
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

    A loop that is stuck cannot set it: `Rescue` ends it then. With a `rescue` there is a report to deliver, so once the
    loop is closed, signals have no effect. In any other process, they then have their default effect.
    """
    stop = asyncio.Event()

    def note() -> None:
        if stop.is_set() and again is not None:
            again.set()
        stop.set()

    _StopHandler(loop, note, rescue).take(signal.SIGINT, signal.SIGTERM)
    return stop
