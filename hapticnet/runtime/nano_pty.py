"""The simulated Nano on a pseudo-terminal that any program can open as a serial port, in real time."""

import asyncio
import contextlib
import errno
import os
import termios
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Final

from hapticnet.errors import FileError, UnavailableError
from hapticnet.runtime.nano import SLICE_US, Board
from hapticnet.runtime.signals import stop_on_signals
from hapticnet.runtime.timer import Repeating, Ticker, until

MOST_CATCH_UP_US: Final = 50_000  # longest stall [µs] that is made up for; the rest of a longer one is skipped

TERMINALS: Final = "/dev/pts/"  # directory of pseudo-terminals: pts(4)
MOST_BYTES: Final = 4096  # largest number of bytes read at a time: the capacity of a pseudo-terminal


class NanoPty:
    """A board on a pseudo-terminal, to which `link` is a symbolic link.

    As with a real port, output of the firmware is lost while the port is closed. Unlike a real port, opening it does
    not reset the controller. Raises UnavailableError if there is no pseudo-terminal; FileError if the link cannot be
    made.
    """

    def __init__(self, board: Board, *, link: Path | None = None) -> None:
        self.board = board  # firmware and plant
        self.visited = False  # whether a program has it open
        self.lost_us = 0  # real time [µs] skipped after stalls
        self._link: Path | None = None
        self._simulated_us = 0
        self._reached_us: int | None = None
        try:
            self._master, visitor = os.openpty()
        except OSError as error:
            raise UnavailableError(f"cannot create a pseudo-terminal: {error.strerror}") from error
        try:
            self.path = os.ttyname(visitor)  # the pseudo-terminal to open
            tty.setraw(visitor)  # remains in force as long as this end is open
            os.set_blocking(self._master, False)
            if link is not None:
                self._make_link(link)
        except BaseException:
            os.close(self._master)
            raise
        finally:
            # Only visitors hold this end, so that their coming and going can be detected.
            os.close(visitor)

    def advance(self, now_us: int) -> None:
        """Advance the board to `now_us`, and carry bytes; raise UnavailableError if the simulator has ended."""
        reached_us = now_us if self._reached_us is None else self._reached_us
        self._reached_us = now_us
        elapsed_us = min(max(now_us - reached_us, 0), MOST_CATCH_UP_US)
        self.lost_us += max(now_us - reached_us, 0) - elapsed_us
        data = self._read()
        end_us = self._simulated_us + elapsed_us
        while self._simulated_us < end_us:
            self._simulated_us = min(self._simulated_us + SLICE_US, end_us)
            self._write(self.board.advance(self._simulated_us, data))
            data = b""

    def close(self) -> None:
        """Remove the link and close the pseudo-terminal; the owner closes the board."""
        if self._link is not None:
            with contextlib.suppress(OSError):  # already removed, or replaced by another
                if os.readlink(self._link) == self.path:
                    self._link.unlink()
        os.close(self._master)

    def _make_link(self, link: Path) -> None:
        if os.path.lexists(link) and not (link.is_symlink() and os.readlink(link).startswith(TERMINALS)):
            raise FileError(f"{link}: exists and was not created by hapticnet; choose another path")
        made = link.with_name(f".{link.name}.{os.getpid()}")
        try:
            made.symlink_to(self.path)
            made.replace(link)
        except OSError as error:
            with contextlib.suppress(OSError):
                made.unlink()
            raise FileError(f"{link}: cannot create the link: {error.strerror}") from error
        self._link = link

    def _read(self) -> bytes:
        try:
            data = os.read(self._master, MOST_BYTES)
        except BlockingIOError:
            data = b""
        except OSError as error:
            if error.errno != errno.EIO:  # EIO: no program has the other end open
                raise UnavailableError(f"{self.path} cannot be read: {error.strerror}") from error
            if self.visited:
                self.visited = False
                self._forget_unread()
            return b""
        self.visited = True
        return data

    def _forget_unread(self) -> None:
        """Discard input that the last visitor left unread; this is possible only from a visitor's end."""
        with contextlib.suppress(OSError, termios.error):
            visitor = os.open(self.path, os.O_RDWR | os.O_NOCTTY)
            try:
                termios.tcflush(visitor, termios.TCIFLUSH)
            finally:
                os.close(visitor)

    def _write(self, data: bytes) -> None:
        if data and self.visited:
            # Output that does not fit because the visitor does not read is lost; a departure is noticed next time.
            with contextlib.suppress(OSError):
                os.write(self._master, data)


async def run_nano_pty(nano: NanoPty, *, duration_s: float | None, on_status: Callable[[], None]) -> None:
    """Run until SIGINT, SIGTERM or `duration_s` [s] have passed; raise UnavailableError if the simulator ends."""
    loop = asyncio.get_running_loop()
    stop = stop_on_signals(loop)
    failures: list[UnavailableError] = []

    def tick(now_us: int) -> None:
        try:
            nano.advance(now_us)
        except UnavailableError as error:
            failures.append(error)
            stop.set()

    ticker = Ticker(loop, SLICE_US, tick)
    status = Repeating(loop, on_status)
    try:
        await until(stop, duration_s)
    finally:
        status.cancel()
        ticker.stop()
    if failures:
        raise failures[0]
