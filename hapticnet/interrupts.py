"""Signals that end a process, seen from code that neither installs nor receives them."""

import signal
import threading


class TakesSignals:
    """Base of the handlers of runs that end in order, with a report: their Ctrl-C raises no KeyboardInterrupt."""


def is_ctrl_c(error: BaseException) -> bool:
    """Return whether an exception from a user's code may be a Ctrl-C at the terminal."""
    return (
        isinstance(error, KeyboardInterrupt)
        and threading.current_thread() is threading.main_thread()
        and not isinstance(signal.getsignal(signal.SIGINT), TakesSignals)
    )


def ignore_further() -> None:
    """Ignore a run's signals, so that they cannot change its end. Call this once the exit code is known."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if isinstance(signal.getsignal(number), TakesSignals):
            signal.signal(number, signal.SIG_IGN)
