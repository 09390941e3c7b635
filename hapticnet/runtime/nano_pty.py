"""The simulated Nano behind a pseudo-terminal that any program can open as a serial port, paced to real time."""

import asyncio
import contextlib
import errno
import os
import termios
import tty
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from hapticnet.errors import FileError, UnavailableError
from hapticnet.runtime.nano import SLICE_US, Board
from hapticnet.runtime.processes import Repeating, stop_on_signals, until
from hapticnet.runtime.timer import Ticker

MOST_CATCH_UP_US: Final = 50_000
"""Most time [µs] made up for in one go; of a longer stall the rest is lost, and the firmware knows nothing of it."""

TERMINALS: Final = "/dev/pts/"
"""Where pseudo-terminals are: pts(4)."""

MOST_BYTES: Final = 4096
"""Most bytes taken from a visitor at a time: all that a pseudo-terminal holds."""


class NanoPty:
    """A board on a pseudo-terminal; a context manager, which lets go of all of it.

    As on a real port, what the firmware sends while nobody listens is lost. Unlike a real one, opening it does not
    reset the controller.

    Parameters
    ----------
    board
        Firmware and plant.
    link
        Where to leave a symbolic link to the pseudo-terminal, for a name that stays the same.

    Attributes
    ----------
    path
        The pseudo-terminal to open.
    visited
        Whether someone has it open.
    lost_us
        Real time [µs] not made up for after stalls.

    Raises
    ------
    UnavailableError
        If there is no pseudo-terminal to be had.
    FileError
        If the link cannot be made; what is there and no link is left alone.
    """

    def __init__(self, board: Board, *, link: Path | None = None) -> None:
        self.board = board
        self.visited = False
        self.lost_us = 0
        self._link: Path | None = None
        self._simulated_us = 0
        self._reached_us: int | None = None
        try:
            self._master, visitor = os.openpty()
        except OSError as error:
            raise UnavailableError(f"no pseudo-terminal to be had: {error.strerror}") from error
        try:
            self.path = os.ttyname(visitor)
            tty.setraw(visitor)  # stays so as long as our end is open
            os.set_blocking(self._master, False)
            if link is not None:
                self._make_link(link)
        except BaseException:
            os.close(self._master)
            raise
        finally:
            # Only visitors hold this end, so that we see them come and go.
            os.close(visitor)

    def advance(self, now_us: int) -> None:
        """Let the board catch up with the clock [µs], and carry bytes.

        Raises
        ------
        UnavailableError
            If the simulator has ended.
        """
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
        """Take the link away and close the pseudo-terminal; the board is its owner's to end."""
        if self._link is not None:
            with contextlib.suppress(OSError):  # gone already, or no longer ours
                if os.readlink(self._link) == self.path:
                    self._link.unlink()
        os.close(self._master)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _make_link(self, link: Path) -> None:
        if os.path.lexists(link) and not (link.is_symlink() and os.readlink(link).startswith(TERMINALS)):
            raise FileError(f"{link}: is there, and no link of an earlier device; name another place")
        made = link.with_name(f".{link.name}.{os.getpid()}")
        try:
            made.symlink_to(self.path)
            made.replace(link)
        except OSError as error:
            with contextlib.suppress(OSError):
                made.unlink()
            raise FileError(f"{link}: the link cannot be made: {error.strerror}") from error
        self._link = link

    def _read(self) -> bytes:
        try:
            data = os.read(self._master, MOST_BYTES)
        except BlockingIOError:
            data = b""
        except OSError as error:
            if error.errno != errno.EIO:  # which says that nobody has the other end open
                raise UnavailableError(f"{self.path} cannot be read: {error.strerror}") from error
            if self.visited:
                self.visited = False
                self._forget_unread()
            return b""
        self.visited = True
        return data

    def _forget_unread(self) -> None:
        """Let the next visitor find nothing of what the last one left; only from a visitor's end can it be done."""
        with contextlib.suppress(OSError, termios.error):
            visitor = os.open(self.path, os.O_RDWR | os.O_NOCTTY)
            try:
                termios.tcflush(visitor, termios.TCIFLUSH)
            finally:
                os.close(visitor)

    def _write(self, data: bytes) -> None:
        if data and self.visited:
            # What a visitor who does not read leaves no room for is lost; one who has just left is seen next time.
            with contextlib.suppress(OSError):
                os.write(self._master, data)


async def run_nano_pty(nano: NanoPty, *, duration_s: float | None, on_status: Callable[[], None]) -> None:
    """Run in real time until SIGINT, SIGTERM or the end of `duration_s` [s].

    Raises
    ------
    UnavailableError
        If the simulator ends by itself.
    """
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
