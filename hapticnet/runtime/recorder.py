"""Recordings of running nodes: rows and events go to the writer process in batches, between ticks."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgpack

from hapticnet.errors import FileError
from hapticnet.recordings.session.archive import FILES
from hapticnet.recordings.session.frames import FrameKind, Heading, pack_begin, pack_frame, pack_rows_header
from hapticnet.recordings.session.session import Table
from hapticnet.runtime.processes import SideProcess
from hapticnet.runtime.system import now_us
from hapticnet.runtime.writer import DONE, FAILED, STOPPED

if TYPE_CHECKING:
    from array import array

FILE_LIMIT: Final = 1000  # most files and folders that the recordings of a run may be
RECORD_LIMIT_BYTES: Final = 2 * 2**30  # disk space [B] that recordings may take unless another limit is given

MOST_WAITING_BYTES: Final = 64 * 2**20
"""Most bytes that wait for the writer: 10 minutes of one session of 1 kHz, 10 s of 64."""

FINISH_WITHIN_S: Final = 60.0  # longest time that the end of a run waits for the writer


class Recorder:
    """Hand recordings to a writer process.

    `start`, then `open` each, give it `rows`, `end` each, and `finish` the run; `pump` again and again. Only `finish`
    waits. A disk that is full, slow or gone ends the recording, not the run.

    `tell`: Called with a line for the user when something is not recorded.
    `limit_bytes`: Bound of the disk space taken.
    `about`: Configuration, seed and versions, for every file.
    """

    def __init__(
        self, tell: Callable[[str], None], *, limit_bytes: int, about: Mapping[str, Any] | None = None
    ) -> None:
        self.process: SideProcess | None = None  # The writer; None before `start`.
        self.stopped: str | None = None  # Why nothing more is recorded; None while something is.
        self._fault: str | None = None  # the first thing that was not recorded as it should
        self._tell = tell
        self._limit_bytes = limit_bytes
        self._about = dict(about or {})
        self._files = 0
        self._begun = 0
        self._completed: int | None = None  # as the writer says
        self._not_recorded = 0
        self._path: Path | None = None  # of the only recording

    @property
    def is_behind(self) -> bool:
        """Whether bytes wait for the writer."""
        return self.process is not None and self.process.waiting_bytes > 0

    def start(self) -> None:
        """Start the writer; raise UnavailableError if this fails."""
        self.process = SideProcess("hapticnet.runtime.writer", str(self._limit_bytes))

    def open(
        self, path: Path, side: str, tables: Sequence[Table], unix_offset_us: int, about: Mapping[str, Any]
    ) -> int | None:
        """Begin a recording and return its number; None if there are too many.

        `tables`: The main one first.
        `unix_offset_us`: Add it to the rows' `t_us` for µs since 1970.
        """
        files = FILES[path.suffix.lower()]
        if self._files + files > FILE_LIMIT:
            if not self._not_recorded:
                self._tell(f"the recordings have {FILE_LIMIT:,} files; a session that begins now is not recorded")
            self._not_recorded += 1
            return None
        self._files += files
        self._path = None if self._begun else path.absolute()
        self._begun += 1
        heading = Heading(
            path=path.absolute(),
            side=side,
            tables=tuple(tables),
            unix_offset_us=unix_offset_us,
            about={**self._about, **about},
        )
        self._put(pack_begin(self._begun, heading))
        return self._begun

    def rows(self, number: int, table: int, numbers: "array[float]") -> None:
        """Record rows as one flat array, which must not change any more."""
        rows = memoryview(numbers).cast("B")
        self._put(pack_rows_header(number, table, rows.nbytes))
        self._put(rows)

    def event(self, number: int, t_us: int, event: object) -> None:
        """Record an event of a node."""
        content = msgpack.packb([t_us, type(event).__name__, event_text(event)])
        self._put(pack_frame(FrameKind.EVENT, number, content))

    def end(self, number: int, about: Mapping[str, Any]) -> None:
        """Complete a recording; `about` is what is known only now, such as the report."""
        self._put(pack_frame(FrameKind.ABOUT, number, msgpack.packb(dict(about), default=str)))
        self._put(pack_frame(FrameKind.END, number))

    def pump(self) -> None:
        """Pass on what the writer takes now, and listen to it. Does not wait."""
        if self.process is not None:
            self.process.pump()
            self._listen(self.process)

    def finish(self) -> None:
        """Pass on everything and wait until the files are complete, for at most `FINISH_WITHIN_S`."""
        process = self.process
        if process is not None:
            self._listen(process)
            if process.finish(FINISH_WITHIN_S):
                self._listen(process)
                process.close()
            else:
                self.stop(f"the disk is slow; process {process.pid} goes on writing", is_fault=True)
        if self._not_recorded:
            self._tell(f"{self._not_recorded:,} sessions were not recorded")

    def check(self) -> None:
        """Raise FileError if a recording could not be written completely. Reaching the limit is no error."""
        if self._fault is not None:
            raise FileError(f"the recordings are incomplete: {self._fault}")

    def report(self) -> dict[str, Any]:
        """Return the account of what was recorded for JSON."""
        return {
            "begun": self._begun,
            "completed": self._completed,
            "sessions_not_recorded": self._not_recorded,
            "stopped": self.stopped,
        }

    def stop(self, reason: str, *, is_fault: bool) -> None:
        """Record nothing more, and tell why; what waits is still written."""
        if is_fault:
            self._fault = self._fault or reason
        if self.stopped is None:
            self.stopped = reason
            self._tell(f"recording stops: {reason}")

    def _put(self, data: bytes | memoryview) -> None:
        process = self.process
        if self.stopped is not None or process is None:
            return
        if process.waiting_bytes + len(data) > MOST_WAITING_BYTES:
            self.stop("the writer cannot keep up; the disk is slow, or the processor busy", is_fault=True)
        else:
            process.put(data)

    def _listen(self, process: SideProcess) -> None:
        code = process.exit_code
        for line in process.said():
            self._hear(process, *json.loads(line))
        if code is not None and self._completed is None and self.stopped is None:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            which = self._path or "FILE"
            self.stop(
                f"its writer process ended ({how}); 'hapticnet recover {which}' completes what was written",
                is_fault=True,
            )

    def _hear(self, process: SideProcess, kind: str, text: str) -> None:
        if kind == DONE:
            self._completed = int(text)
            if self._completed < self._begun and self.stopped is None:
                self.stop(f"its writer completed {self._completed:,} of {self._begun:,} files", is_fault=True)
        elif kind in (STOPPED, FAILED):
            self.stop(text, is_fault=kind == FAILED)
            process.drop()
        else:
            self._fault = self._fault or text
            self._tell(text)


def unix_offset_us() -> int:
    """Return what to add to this process's `now_us` for µs since 1970."""
    return time.time_ns() // 1000 - now_us()


def event_text(event: object) -> str:
    """Return the plain fields of an event as JSON. Tickets, keys and objects of the node are left out."""
    return json.dumps(_plain(event), default=str)


def _plain(value: object) -> dict[str, Any]:
    if is_dataclass(value) and not isinstance(value, type):
        items = {field.name: getattr(value, field.name) for field in fields(value)}
    else:
        items = getattr(value, "_asdict", dict)()
    kept: dict[str, Any] = {}
    for name, item in items.items():
        if item is None or isinstance(item, (str, int, float, dict)):  # a dict: the parameters of a codec
            kept[name] = item
        elif hasattr(item, "_asdict"):
            kept[name] = _plain(item)
    return kept
