"""Recordings as CSV: samples in FILE.csv; datagrams, events and the configuration in files beside it."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from hapticnet.arrays import FloatArray
from hapticnet.recordings.session.frames import Heading, as_type
from hapticnet.recordings.session.sink import Sink, free_suffix

NUMBER_BYTES: Final = 25
"""Longest text of a float64 with its separator: -1.2345678901234567e-100."""

EVENT_COLUMNS: Final = ("t_us", "event", "text")
FIXED_BYTES: Final = 4096


class CsvWriter:
    """Write a recording; satisfies `archive.RecordingWriter`.

    The main table is FILE.csv, the others FILE.TABLE.csv, and FILE.events.csv; FILE.about.json has the configuration.

    Raises
    ------
    OSError
        Here and in all methods, if a file cannot be written.
    """

    def __init__(self, heading: Heading) -> None:
        self._heading = heading
        self._about = dict(heading.about) | {"side": heading.side, "unix_offset_us": heading.unix_offset_us}
        self._tables: list[Sink | None] = [None for _ in heading.tables]
        self._events: Sink | None = None
        self._suffix = free_suffix(heading.path, *self._others)
        self._about_sink = Sink(beside(heading.path, "about.json"), suffix=self._suffix)
        self._about_sink.write(_json(self._about))
        self._about_sink.flush()
        self._table(0)

    @property
    def files(self) -> tuple[Sink, ...]:
        """The files being written, the main one first."""
        return tuple(sink for sink in (*self._tables, self._events, self._about_sink) if sink is not None)

    @property
    def size(self) -> int:
        """At most how large the files would be together if they were finished now [B]."""
        return sum(sink.tell() for sink in self.files) + FIXED_BYTES

    def bound(self, table: int, rows: int) -> int:
        """Return at most how many bytes this many more rows take."""
        return rows * NUMBER_BYTES * len(self._heading.tables[table].columns)

    def rows(self, table: int, rows: FloatArray) -> None:
        """Add rows, shape (n, columns)."""
        columns = [
            column.tolist() if kind == "f8" else _whole(column, kind)
            for column, kind in zip(rows.T, self._heading.tables[table].types, strict=True)
        ]
        self._table(table).write(_lines(list(zip(*columns, strict=True))))

    def event(self, t_us: int, name: str, text: str) -> None:
        """Add an event."""
        if self._events is None:
            self._events = Sink(beside(self._heading.path, "events.csv"), suffix=self._suffix)
            self._events.write(_lines([EVENT_COLUMNS]))
        self._events.write(_lines([(t_us, name, text)]))

    def flush(self) -> None:
        """Pass everything to the operating system."""
        for sink in self.files:
            sink.flush()

    def finish(self, about: Mapping[str, Any]) -> None:
        """Complete the files; `about` are further facts, such as the report."""
        self.flush()
        if about:
            whole = Sink(self._about_sink.path, suffix=f"{self._suffix}.whole")
            whole.write(_json(self._about | dict(about)))
            whole.flush()
            self._about_sink.discard()
            self._about_sink = whole
        for path in self._others:  # of an earlier recording of this name
            path.unlink(missing_ok=True)
        for sink in reversed(self.files):  # the main one last
            sink.finish()

    @property
    def _others(self) -> list[Path]:
        """The files beside the main one."""
        names = [f"{table.name}s.csv" for table in self._heading.tables[1:]]
        return [beside(self._heading.path, name) for name in (*names, "events.csv", "about.json")]

    def _table(self, index: int) -> Sink:
        sink = self._tables[index]
        if sink is None:
            table = self._heading.tables[index]
            path = self._heading.path
            file = path if index == 0 else beside(path, f"{table.name}s.csv")
            sink = self._tables[index] = Sink(file, suffix=self._suffix)
            sink.write(_lines([table.columns]))
        return sink


def beside(path: Path, what: str) -> Path:
    """Return the name of a file that belongs to FILE.csv."""
    return path.with_name(f"{path.stem}.{what}")


def _whole(column: FloatArray, kind: str) -> list[int | str]:
    whole = as_type(column, kind).tolist()
    return ["" if math.isnan(value) else number for value, number in zip(column.tolist(), whole, strict=True)]


def _lines(rows: Sequence[Sequence[object]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _json(about: Mapping[str, Any]) -> bytes:
    return (json.dumps(about, indent=2, default=str) + "\n").encode()
