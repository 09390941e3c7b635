"""Watchers of a running node: messages, recorder, page, metrics. None of them can delay or end the run."""

import os
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, Generic, TypeVar

from hapticnet.errors import in_words
from hapticnet.user_code import close_user_object

Event = TypeVar("Event")


class Watcher(Generic[Event]):
    """Base class of watchers. Override the methods you need; the others cost nothing.

    Everything is called on the event loop of the run. A watcher that raises is reported once and not called again;
    the run continues without it. Only an error in `start` ends the run, before it has begun.
    """

    name = "watcher"  # its name in messages

    async def start(self) -> None:
        """Begin, before the first tick. An exception ends the run."""

    def observe(self, now_us: int) -> None:
        """Look at the node after a tick, or after answers, when the datagrams are sent. Must take at most a few µs."""

    def note(self, event: Event, now_us: int) -> None:
        """Process an event of the node."""

    def check(self, now_us: int) -> None:
        """Do the work due twice a second."""

    async def stop(self) -> None:
        """End, after the last tick."""


class Closing(Watcher[Any]):
    """Call ``close()`` of a user's object, named `what` in messages, after the last tick, if it has that method."""

    def __init__(self, made: object, what: str, say: Callable[[str], None]) -> None:
        self._made = made
        self._what = what
        self._say = say

    async def stop(self) -> None:
        """Close the object."""
        fault = close_user_object(self._made, self._what)
        if fault is not None:
            self._say(fault)


class Watchers(Generic[Event]):
    """The watchers of a run; `tell` is called with a line for the user if one fails."""

    def __init__(self, watchers: Sequence[Watcher[Event]], tell: Callable[[str], None]) -> None:
        self._watchers = list(watchers)
        self._started: list[Watcher[Event]] = []
        self._tell = tell
        self.observers: list[Callable[[int], None]] = []  # the `observe` of those watchers that have one

    async def start(self) -> None:
        """Start them all; if one cannot start, stop the others and raise its error."""
        try:
            for watcher in self._watchers:
                await watcher.start()
                self._started.append(watcher)
        except BaseException:
            await self.stop()
            raise
        self._find_observers()

    def observe(self, now_us: int) -> None:
        """Let each watcher look at the node."""
        for observe in self.observers:
            try:
                observe(now_us)
            except Exception as error:
                self._drop(observe.__self__, error)  # type: ignore[attr-defined]

    def note(self, event: Event, now_us: int) -> None:
        """Pass an event on."""
        self._each(lambda watcher: watcher.note(event, now_us))

    def check(self, now_us: int) -> None:
        """Let each watcher do its work due twice a second."""
        self._each(lambda watcher: watcher.check(now_us))

    async def stop(self) -> None:
        """Stop those that were started, the last one first."""
        while self._started:
            watcher = self._started.pop()
            try:
                await watcher.stop()
            except Exception as error:
                self._drop(watcher, error)

    def _each(self, call: Callable[[Watcher[Event]], None]) -> None:
        for watcher in tuple(self._watchers):
            try:
                call(watcher)
            except Exception as error:
                self._drop(watcher, error)

    def _find_observers(self) -> None:
        self.observers = [each.observe for each in self._watchers if type(each).observe is not Watcher.observe]

    def _drop(self, watcher: Watcher[Event], error: Exception) -> None:
        if watcher in self._watchers:
            self._watchers.remove(watcher)
            self._find_observers()
            self._tell(f"{watcher.name} failed and is switched off: {in_words(error)}")


EXTENSION_US: Final = 10_000_000  # time [µs] by which systemd extends its wait, repeatedly, while masters finish


class Notifier(Watcher[Event], Generic[Event]):
    """Notify systemd on its socket `path` that the process is ready, and then twice a second that its event loop runs.

    `status` returns a line for ``systemctl status``; `stopping`, whether the process is about to end and waits for
    masters, so that systemd waits too. A unit with ``WatchdogSec=`` thus notices a stuck loop.
    """

    name = "systemd"

    def __init__(self, path: str, status: Callable[[], str], stopping: Callable[[], bool] = lambda: False) -> None:
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._status = status
        self._stopping = stopping
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    async def start(self) -> None:
        """Report that the process is ready."""
        self._send("READY=1")

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Report that the loop runs."""
        more = f"\nEXTEND_TIMEOUT_USEC={EXTENSION_US}" if self._stopping() else ""
        self._send(f"WATCHDOG=1\nSTATUS={self._status()}{more}")

    async def stop(self) -> None:
        """Report that the process is about to end."""
        self._send("STOPPING=1")
        self._socket.close()

    def _send(self, message: str) -> None:
        with suppress(OSError):  # systemd is not reading, or is gone
            self._socket.sendto(message.encode(), self._address)


def notify_socket(environment: Mapping[str, str] = os.environ) -> str | None:
    """Return the socket on which systemd expects messages; None if it expects none."""
    path = environment.get("NOTIFY_SOCKET", "")
    return path if path.startswith(("/", "@")) else None
