"""Frames carried out by the writer process: recordings as MCAP or CSV, within a limit of disk space."""

import csv
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import HapticnetError, SettingsError, UnavailableError, in_words
from hapticnet.files import written_beside
from hapticnet.recordings.session.frames import FrameKind, Heading
from hapticnet.recordings.session.mcap_writer import NEEDS_MCAP, McapWriter
from hapticnet.recordings.session.session import as_type
from hapticnet.recordings.session.sink import Sink, beside, free_suffix

NUMBER_BYTES: Final = 25  # longest text of a float64 with its separator: -1.2345678901234567e-100
FIXED_BYTES: Final = 4096
EVENT_COLUMNS: Final = ("t_us", "event", "text")


class CsvWriter:
    """Write a recording as FILE.csv, FILE.TABLE.csv, FILE.events.csv and FILE.about.json; raise OSError on failure."""

    def __init__(self, heading: Heading) -> None:
        self._heading = heading
        self._about = dict(heading.about) | {"side": heading.side, "unix_offset_us": heading.unix_offset_us}
        self._paths = [
            heading.path,
            *(beside(heading.path, f"{table.name}s.csv") for table in heading.tables[1:]),
            beside(heading.path, "events.csv"),
        ]
        self._about_path = beside(heading.path, "about.json")
        self._suffix = free_suffix(*self._paths, self._about_path)
        self._sinks: dict[int, Sink] = {}
        self._sink(0)
        self._write_about()

    @property
    def files(self) -> tuple[Sink, ...]:
        """The files being written, the main one first."""
        return tuple(self._sinks.values())

    @property
    def size(self) -> int:
        """Upper limit of the total size of the files if finished now [B]."""
        return sum(sink.tell() for sink in self.files) + self._about_bytes + FIXED_BYTES

    def bound(self, table: int, rows: int) -> int:
        """Return the most bytes that this many more rows take."""
        return rows * NUMBER_BYTES * len(self._heading.tables[table].columns)

    def rows(self, table: int, rows: FloatArray) -> None:
        """Add rows, shape (n, columns)."""
        columns = [
            column.tolist() if kind == "f8" else _whole(column, kind)
            for column, kind in zip(rows.T, self._heading.tables[table].types, strict=True)
        ]
        self._sink(table).write(_lines(list(zip(*columns, strict=True))))

    def event(self, t_us: int, name: str, text: str) -> None:
        """Add an event."""
        self._sink(len(self._heading.tables)).write(_lines([(t_us, name, text)]))

    def flush(self) -> None:
        """Pass everything to the operating system."""
        for sink in self.files:
            sink.flush()

    def finish(self, about: Mapping[str, Any]) -> None:
        """Complete the files; `about` are further facts, such as the report."""
        self.flush()
        self._about |= about
        self._write_about()
        for path in self._paths[1:]:  # left by an earlier recording of this name
            path.unlink(missing_ok=True)
        self._unfinished_about.replace(self._about_path)
        for sink in reversed(self.files):  # the main one last
            sink.finish()

    @property
    def _unfinished_about(self) -> Path:
        return self._about_path.with_name(self._about_path.name + self._suffix)

    def _write_about(self) -> None:
        text = (json.dumps(self._about, indent=2, default=str) + "\n").encode()
        self._about_bytes = len(text)
        with written_beside(self._unfinished_about) as file:  # a full disk must not destroy the existing one
            file.write(text)

    def _sink(self, index: int) -> Sink:
        """Return the file of a table, or of the events behind the tables; begin it if it is new."""
        if index not in self._sinks:
            tables = self._heading.tables
            sink = self._sinks[index] = Sink(self._paths[index], suffix=self._suffix)
            sink.write(_lines([tables[index].columns if index < len(tables) else EVENT_COLUMNS]))
        return self._sinks[index]


Writer = McapWriter | CsvWriter
FORMATS: Final[dict[str, Callable[[Heading], Writer]]] = {".mcap": McapWriter, ".csv": CsvWriter}  # by suffix
FILES: Final = {".mcap": 1, ".csv": 4}  # files of a recording of two tables by its suffix


def check_format(path: Path) -> None:
    """Raise SettingsError if a recording cannot have this name, UnavailableError if its format needs an extra."""
    suffix = path.suffix.lower()
    if suffix == ".npz":
        raise SettingsError(
            f"{path}: a session is recorded as .mcap or .csv; 'hapticnet export FILE --format npz' converts it"
        )
    if suffix not in FORMATS:
        raise SettingsError(f"{path}: a recording is a .mcap or .csv file")
    if suffix == ".mcap":
        check_mcap()


def check_mcap() -> None:
    """Raise UnavailableError if the extra ``record`` is not installed."""
    if find_spec("mcap") is None:
        raise UnavailableError(NEEDS_MCAP)


class Archive:
    """Carry out frames; the first fault, or the limit, completes everything so far, if the disk permits.

    `stop` is called once then: with the reason, and whether it is a fault; `tell` with other messages.
    """

    def __init__(self, stop: Callable[[str, bool], None], tell: Callable[[str], None], *, limit_bytes: int) -> None:
        self.stopped = False
        self.completed = 0  # recordings that are complete
        self._stop = stop
        self._tell = tell
        self._limit_bytes = limit_bytes
        self._saved_bytes = 0
        self._open: dict[int, tuple[Writer, Heading, dict[str, Any]]] = {}

    def take(self, kind: int, number: int, *content: Any) -> None:
        """Carry out a frame."""
        if self.stopped:
            return
        try:
            self._take(FrameKind(kind), number, content)
        except (OSError, HapticnetError) as error:
            self._fail(number, error)

    def flush(self) -> None:
        """Pass everything to the operating system."""
        for number in list(self._open):
            if number in self._open:  # a fault ends all
                try:
                    self._open[number][0].flush()
                except OSError as error:
                    self._fail(number, error)

    def finish(self) -> None:
        """Complete all recordings."""
        for number in list(self._open):
            self._finish(number)

    def _take(self, kind: FrameKind, number: int, content: tuple[Any, ...]) -> None:
        if kind is FrameKind.BEGIN:
            heading = Heading.of(content[0])
            self._open[number] = FORMATS[heading.path.suffix.lower()](heading), heading, {}
            return
        if number not in self._open:
            return
        writer, heading, about = self._open[number]
        if kind is FrameKind.ROWS:
            table, data = content
            rows = np.frombuffer(data).reshape(-1, len(heading.tables[table].columns))
            if shift_us := heading.tables[table].shift_us:
                rows = np.concatenate([rows[:, :1] + shift_us, rows[:, 1:]], axis=1)
            size = self._saved_bytes + sum(writer.size for writer, _, _ in self._open.values())
            if size + writer.bound(table, len(rows)) > self._limit_bytes:
                self._end(f"the limit of {self._limit_bytes:,} bytes for recordings is reached", is_fault=False)
            else:
                writer.rows(table, rows)
        elif kind is FrameKind.EVENT:
            writer.event(*content)
        elif kind is FrameKind.ABOUT:
            about |= content[0]
        else:
            self._finish(number)

    def _finish(self, number: int) -> None:
        if number not in self._open:
            return
        writer, _, about = self._open[number]
        try:
            writer.finish(about)
        except (OSError, HapticnetError) as error:
            self._fail(number, error)
        else:
            del self._open[number]
            self._saved_bytes += writer.size
            self.completed += 1

    def _fail(self, number: int, error: Exception) -> None:
        """Abandon a recording, and end the others."""
        reason = in_words(error)
        if isinstance(error, OSError):
            reason = f"{error.filename or ''}: {error.strerror}".removeprefix(": ")
        if number in self._open:
            writer, heading, _ = self._open.pop(number)
            kept = any(sink.size for sink in writer.files)
            for sink in writer.files:
                sink.close()
            reason = f"{heading.path}: {getattr(error, 'strerror', None) or reason}"
            if kept:
                reason += f"; what was written can be completed with 'hapticnet export {writer.files[0].file}'"
        if self.stopped:
            self._tell(reason)
        else:
            self._end(reason, is_fault=True)

    def _end(self, reason: str, *, is_fault: bool) -> None:
        self.stopped = True
        self._stop(reason, is_fault)
        self.finish()


def _whole(column: FloatArray, kind: str) -> list[int | str]:
    whole = as_type(column, kind).tolist()
    return ["" if math.isnan(value) else number for value, number in zip(column.tolist(), whole, strict=True)]


def _lines(rows: Sequence[Sequence[object]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
