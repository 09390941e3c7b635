"""Non-blocking log: the lines of a process on stderr, for a reader who may pause (a full pipe, a stopped terminal)."""

import atexit
import logging
import math
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Enum
from queue import Empty, SimpleQueue
from typing import Final, TextIO

from hapticnet.errors import FileError, visible
from hapticnet.protocol.buckets import TokenBucket
from hapticnet.runtime.system import now_us, start_background


class Level(Enum):
    """The severity of a line."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class Form(Enum):
    """The form of a line."""

    PLAIN = "plain"  # ``master: link stale``, for interactive commands
    STAMPED = "stamped"  # ``2026-11-22T08:17:50.123Z warning master: link stale``, for long-running processes
    JOURNAL = "journal"  # ``<4>master: link stale``: the journal adds the time itself (sd-daemon(3))


PRIORITIES: Final = {Level.INFO: 6, Level.WARNING: 4, Level.ERROR: 3}  # the levels of syslog(3)


@dataclass(frozen=True, slots=True)
class LogLine:
    """A message to the observer of a process."""

    text: str
    who: str  # part of the program that sends it
    level: Level = Level.INFO
    time_s: float = field(default_factory=time.time)  # Unix time of the message, possibly long before it is written

    def write(self, form: Form) -> str:
        """Return the line, with its line end. It has no control characters, even if it quotes a file or peer."""
        text = visible(self.text)
        if form is Form.STAMPED:  # in UTC (RFC 3339), so that the logs of two hosts can be compared
            stamp = datetime.fromtimestamp(self.time_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
            return f"{stamp} {self.level.value} {self.who}: {text}\n"
        if form is Form.JOURNAL:
            return f"<{PRIORITIES[self.level]}>{self.who}: {text}\n"
        return f"{self.who}: {'warning: ' * (self.level is Level.WARNING)}{text}\n"


def is_journal(environment: Mapping[str, str], descriptor: int) -> bool:
    """Return whether a file descriptor is connected to the journal of systemd (JOURNAL_STREAM, systemd.exec(5))."""
    named = environment.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(descriptor)
    except OSError:
        return False
    return named == f"{status.st_dev}:{status.st_ino}"


LINES_PER_S: Final = 20.0
MOST_AT_ONCE: Final = 100  # limits of the lines of a process: a hundred masters may join together
MOST_WAITING: Final = 1000  # most lines that wait for the reader; further ones are omitted
SUMMARY_EVERY_S: Final = 1.0  # time [s] between two lines that count the omitted ones
PARTING_S: Final = 0.5  # time [s] that an ending process waits for the reader of its last lines
CHUNK_BYTES: Final = 4096  # bytes written at once while progress is watched; a pipe accepts this many or none
_ERASE: Final = "\r\x1b[2K"  # return to the start of the line and erase it (ECMA-48 EL)


class NonblockingLog:
    """Lines and a live status line for a stream, which `stream` returns; None if the process has none.

    Until `start`, each line is written at once. From then on a thread writes them, and their rate is limited.
    """

    def __init__(self, stream: Callable[[], TextIO | None]) -> None:
        self.left_out = 0  # omitted lines: too many a second, or the reader paused for too long
        self.form = Form.PLAIN  # how lines are written
        self._stream = stream
        self._queue: SimpleQueue[Callable[[], None]] | None = None
        self._bucket = TokenBucket(LINES_PER_S, MOST_AT_ONCE)
        self._who = ""
        self._summarised = 0
        self._status = ""
        self._status_due = False
        self._shown = False
        self._patience_s = PARTING_S

    def start(self) -> None:
        """Let a thread write from now on."""
        if self._queue is None:
            self._queue = SimpleQueue()
            start_background(self._work, "log")
            atexit.register(self.drain)

    def line(self, line: LogLine, *, needed: bool = False) -> None:
        """Write a line, after removing the status line. A `needed` one is never left out."""
        if self._queue is None:
            self._write_line(line)
        elif needed or (self._queue.qsize() < MOST_WAITING and self._bucket.take(now_us())):
            self._queue.put(lambda: self._write_line(line))
        else:
            self.left_out += 1
            self._who = line.who

    def status(self, text: str) -> None:
        """Replace the status line below all other lines; without text, remove it. Only the newest must be written."""
        self._status = text
        if not self._status_due:
            self._status_due = True
            if self._queue is None:
                self._write_status()
            else:
                self._queue.put(self._write_status)

    def drain(self) -> bool:
        """Wait until all is written; return False if the reader read nothing for `PARTING_S`. Time out only once."""
        if self._queue is None:
            return True
        written = threading.Event()
        self._queue.put(self._summarise)
        self._queue.put(written.set)
        done = written.wait(self._patience_s)
        self._patience_s = PARTING_S if done else 0.0
        return done

    def _work(self) -> None:
        queue = self._queue
        assert queue is not None  # noqa: S101 - for the type checker
        due_s = math.inf
        while True:
            with suppress(Empty):
                queue.get(timeout=SUMMARY_EVERY_S)()
            if self.left_out == self._summarised:
                due_s = math.inf
            elif due_s == math.inf:
                due_s = time.monotonic() + SUMMARY_EVERY_S
            elif time.monotonic() >= due_s:
                self._summarise()

    def _summarise(self) -> None:
        count = self.left_out - self._summarised
        if count:
            self._summarised += count
            text = f"… {count:,} line{'s' * (count != 1)} left out"
            self._write_line(LogLine(text, who=self._who, level=Level.WARNING))

    def _write_line(self, line: LogLine) -> None:
        text = line.write(self.form)
        self._write(_ERASE + text if self._shown else text)
        self._shown = False

    def _write_status(self) -> None:
        self._status_due = False
        if self._status or self._shown:
            self._write(_ERASE + self._status)
        self._shown = bool(self._status)

    def _write(self, text: str) -> None:
        stream = self._stream()
        if stream is None:
            return
        try:
            number = stream.fileno()
        except (OSError, ValueError):  # in a test, or closed
            number = None
        try:
            if number is None:
                stream.write(text)
                stream.flush()
            else:
                # Not through the stream, whose lock the interpreter needs to end.
                _write_all(number, text.encode(stream.encoding or "utf-8", "backslashreplace"))
        except OSError:  # the reader is gone
            with suppress(OSError, ValueError):
                abandon(stream)
        except ValueError:  # closed by the parent process
            pass


STDERR: Final = NonblockingLog(lambda: sys.stderr)  # all messages of this process


class _LogHandler(logging.Handler):
    """Asyncio's report of a callback that raised."""

    def emit(self, record: logging.LogRecord) -> None:
        level = Level.ERROR if record.levelno >= logging.ERROR else Level.WARNING
        STDERR.line(LogLine(self.format(record), who=record.name, level=level))


def never_block() -> None:
    """Let a thread write all messages of this process, including those of the logging module."""
    STDERR.start()
    logging.lastResort = _LogHandler(logging.WARNING)


def keep_log() -> None:
    """Give each line of this process time and level, in the form that the reader of stderr expects."""
    STDERR.form = Form.JOURNAL if is_journal(os.environ, 2) else Form.STAMPED


def write_watched(stream: TextIO, text: str, stall_s: float) -> None:
    """Write a text; raise FileError if the reader reads nothing for `stall_s` [s], OSError if it is gone."""
    try:
        number = stream.fileno()
    except (OSError, ValueError):
        stream.write(text)
        stream.flush()
        return
    stream.flush()
    data = text.encode(stream.encoding or "utf-8", "backslashreplace")
    progress = SimpleQueue[OSError | None]()

    def work() -> None:
        try:
            for start in range(0, len(data), CHUNK_BYTES):
                _write_all(number, data[start : start + CHUNK_BYTES])
                progress.put(None)
        except OSError as error:
            progress.put(error)

    start_background(work, "report")
    for _ in range(0, len(data), CHUNK_BYTES):
        try:
            failure = progress.get(timeout=stall_s)
        except Empty:
            raise FileError(f"stdout is not being read: the report on it is incomplete after {stall_s:g} s") from None
        if failure is not None:
            raise failure


def abandon(stream: TextIO) -> None:
    """Redirect a stream to the null device; otherwise flushing its buffer at exit would fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _write_all(number: int, data: bytes) -> None:
    while data:
        try:
            data = data[os.write(number, data) :]
        except BlockingIOError:  # a parent process made it non-blocking
            select.select([], [number], [])
