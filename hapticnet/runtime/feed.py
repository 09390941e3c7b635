"""The node's end of the pipe to the process that writes recordings."""

import fcntl
import json
import os
import subprocess
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from hapticnet.recordings.session.frames import FrameKind, Heading, pack_begin, pack_frame, pack_rows_header
from hapticnet.runtime.background import start_background
from hapticnet.runtime.interpreter import python_command
from hapticnet.runtime.writer import DONE, FAILED, PIPE_BYTES, STOPPED

if TYPE_CHECKING:
    import threading
    from array import array
    from pathlib import Path

MOST_WAITING_BYTES: Final = 64 * 2**20
"""Most bytes that wait for the writer: 10 minutes of one session of 1 kHz, 10 s of 64."""

MOST_AT_ONCE: Final = 256 * 1024
"""Most bytes that are written in one call: less than 0.1 ms."""

FINISH_WITHIN_S: Final = 60.0
"""Longest time that the end of a run waits for the writer."""

POLL_S: Final = 0.02


class Feed:
    """A writer process, fed without waiting.

    Parameters
    ----------
    tell
        Called with a line for the user.
    limit_bytes
        Bound of the disk space taken.

    Attributes
    ----------
    begun
        Number of recordings that began.
    completed
        Number of those that the writer completed; None if it did not say, or has not yet.
    stopped
        Why nothing more is recorded; None while something is.
    fault
        The first thing that was not recorded as it should; None if there is none.
    """

    def __init__(self, tell: Callable[[str], None], *, limit_bytes: int) -> None:
        self.stopped: str | None = None
        self.fault: str | None = None
        self._tell = tell
        self._limit_bytes = limit_bytes
        self._waiting: deque[memoryview] = deque()
        self._waiting_bytes = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._starting: threading.Thread | None = None
        self._said = b""
        self.begun = 0
        self.completed: int | None = None
        self._path: Path | None = None  # of the only recording
        self._start_fault: str | None = None

    @property
    def pid(self) -> int | None:
        """Process id of the writer; None before it runs."""
        return self._process.pid if self._process is not None else None

    @property
    def is_behind(self) -> bool:
        """Whether bytes wait for the writer."""
        return bool(self._waiting)

    def begin(self, recording: int, heading: Heading) -> None:
        """Begin a recording; the writer starts with the first one."""
        self._path = None if self.begun else heading.path
        self.begun += 1
        if self.begun == 1:
            # From a thread at normal priority: the writer inherits that, and nothing here waits for its start.
            self._starting = start_background(self._start, "start of the writer")
        self._put(pack_begin(recording, heading))

    def rows(self, recording: int, table: int, numbers: "array[float]") -> None:
        """Hand over rows as one flat array, which must not change any more."""
        rows = memoryview(numbers).cast("B")
        self._put(pack_rows_header(recording, table, rows.nbytes))
        self._put(rows)

    def tell_writer(self, kind: FrameKind, recording: int, content: bytes = b"") -> None:
        """Hand over any other frame."""
        self._put(pack_frame(kind, recording, content))

    def pump(self) -> None:
        """Pass on what the pipe takes now, and listen to the writer. Does not wait."""
        process = self._process
        if process is None:
            if self._start_fault is not None and self.stopped is None:
                self.stop(self._start_fault, is_fault=True)
                self._drop()
            return
        assert process.stdin is not None  # noqa: S101 - for the type checker: both are pipes
        written = 0
        try:
            while self._waiting and written < MOST_AT_ONCE:
                piece = self._waiting[0]
                count = os.write(process.stdin.fileno(), piece[:MOST_AT_ONCE])
                written += count
                self._waiting_bytes -= count
                if count == len(piece):
                    self._waiting.popleft()
                else:
                    self._waiting[0] = piece[count:]
        except BlockingIOError:
            pass
        except OSError:  # the writer has gone; its last words say why
            self._drop()
        self._listen(process)

    def finish(self) -> None:
        """Pass on everything and wait until the files are complete, for at most `FINISH_WITHIN_S`."""
        if not self.begun:
            return
        if self._starting is not None:
            self._starting.join()
        self.pump()
        deadline = time.monotonic() + FINISH_WITHIN_S
        while self._process is not None and time.monotonic() < deadline:
            self.pump()
            if not self._waiting:
                with suppress(OSError):
                    self._process.stdin.close()  # type: ignore[union-attr]
            if self._process.poll() is not None:
                self.pump()
                self._process.stdout.close()  # type: ignore[union-attr]
                return
            time.sleep(POLL_S)
        if self._process is not None:
            self.stop(f"the disk is slow; process {self._process.pid} goes on writing", is_fault=True)

    def _put(self, data: bytes | memoryview) -> None:
        if self.stopped is not None:
            return
        view = memoryview(data)
        if self._waiting_bytes + view.nbytes > MOST_WAITING_BYTES:
            self.stop("the writer cannot keep up; the disk is slow, or the processor busy", is_fault=True)
            return
        self._waiting.append(view)
        self._waiting_bytes += view.nbytes

    def _start(self) -> None:
        command = python_command("-m", "hapticnet.runtime.writer", str(self._limit_bytes))
        try:
            process = subprocess.Popen(  # noqa: S603 - our own program, arguments not through a shell
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            self._start_fault = f"the writer cannot be started: {error.strerror}"
            return
        assert process.stdin is not None  # noqa: S101 - for the type checker: both are pipes
        assert process.stdout is not None  # noqa: S101
        os.set_blocking(process.stdin.fileno(), False)
        os.set_blocking(process.stdout.fileno(), False)
        with suppress(AttributeError, OSError):  # not on Linux, or above the user's limit
            fcntl.fcntl(process.stdin.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._process = process

    def _listen(self, process: "subprocess.Popen[bytes]") -> None:
        assert process.stdout is not None  # noqa: S101 - for the type checker: it is a pipe
        try:
            data = os.read(process.stdout.fileno(), 65536)
        except (BlockingIOError, ValueError):
            return
        if not data and self.completed is None and self.stopped is None:
            code = process.poll()
            if code is None:  # it is about to end
                return
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            which = self._path if self._path is not None else "FILE"
            self.stop(
                f"its writer process ended ({how}); 'hapticnet recover {which}' completes what was written",
                is_fault=True,
            )
        *lines, self._said = (self._said + data).split(b"\n")
        for line in lines:
            self._hear(*json.loads(line))

    def _hear(self, kind: str, text: str) -> None:
        if kind == DONE:
            self.completed = int(text)
            if self.completed < self.begun and self.stopped is None:
                self.stop(f"its writer completed {self.completed:,} of {self.begun:,} files", is_fault=True)
        elif kind in (STOPPED, FAILED):
            self.stop(text, is_fault=kind == FAILED)
            self._drop()
        else:
            self.fault = self.fault or text
            self._tell(text)

    def stop(self, reason: str, *, is_fault: bool) -> None:
        """Record nothing more, and tell why; what waits is still written."""
        if is_fault:
            self.fault = self.fault or reason
        if self.stopped is None:
            self.stopped = reason
            self._tell(f"recording stops: {reason}")

    def _drop(self) -> None:
        self._waiting.clear()
        self._waiting_bytes = 0
