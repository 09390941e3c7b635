"""Recordings as NumPy archives: raw columns in a folder while the session runs, one compressed file at the end."""

import json
import os
import shutil
import sys
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.errors import FileError, in_words
from hapticnet.files import open_regular, read_bytes, read_text, written_beside
from hapticnet.recordings.session.frames import Heading, Table, as_type
from hapticnet.recordings.session.protobuf import TYPES
from hapticnet.recordings.session.session import LARGEST_JSON, parse_json
from hapticnet.recordings.session.sink import Sink, free_suffix

ABOUT: Final = "about"
EVENTS: Final = "events"
ROWS_AT_ONCE: Final = 1 << 16
COMPRESSION: Final = 1
FIXED_BYTES: Final = 16 * 1024


class NpzWriter:
    """Write a recording; satisfies `archive.RecordingWriter`.

    Until the end the rows are in a folder, FILE.npz.unfinished: rows of float64 in TABLE.rows, one event per line in
    events.json, and what is needed to read them in about.json.

    Raises
    ------
    OSError
        Here and in all methods, if a file cannot be written.
    """

    def __init__(self, heading: Heading) -> None:
        path = heading.path
        self.folder = path.with_name(path.name + free_suffix(path))
        self.folder.mkdir()
        self._path = path
        self._tables = heading.tables
        self._about = dict(heading.about) | {"side": heading.side, "unix_offset_us": heading.unix_offset_us}
        self._write_about()
        self._sinks = [Sink(self.folder / f"{table.name}.rows", suffix="") for table in heading.tables]
        self._events = Sink(self.folder / f"{EVENTS}.json", suffix="")
        self._packed_bytes: int | None = None

    @property
    def files(self) -> tuple[Sink, ...]:
        """The files being written."""
        return (*self._sinks, self._events)

    @property
    def size(self) -> int:
        """At most how much space is taken at once if the file is finished now: by the rows and by the archive [B]."""
        if self._packed_bytes is not None:
            return self._packed_bytes
        return 2 * sum(sink.tell() for sink in self.files) + FIXED_BYTES

    def bound(self, table: int, rows: int) -> int:
        """Return at most how many bytes this many more rows take."""
        return 2 * rows * 8 * len(self._tables[table].columns)

    def rows(self, table: int, rows: FloatArray) -> None:
        """Add rows, shape (n, columns)."""
        self._sinks[table].write(rows.tobytes())

    def event(self, t_us: int, name: str, text: str) -> None:
        """Add an event."""
        self._events.write((json.dumps([t_us, name, text]) + "\n").encode())

    def flush(self) -> None:
        """Pass everything to the operating system."""
        for sink in self.files:
            sink.flush()

    def finish(self, about: Mapping[str, Any]) -> None:
        """Make the archive; `about` are further facts, such as the report."""
        self.flush()
        self._about |= about
        self._write_about()
        for sink in self.files:
            sink.close()
        pack_folder(self.folder, self._path)
        self._packed_bytes = self._path.stat().st_size

    def _write_about(self) -> None:
        tables = [{"name": table.name, "columns": table.columns, "types": table.types} for table in self._tables]
        text = json.dumps({"about": self._about, "tables": tables}, default=str)
        part = self.folder / f"{ABOUT}.json.part"  # a full disk must not cost the one that is there
        part.write_text(text, encoding="utf-8")
        part.replace(self.folder / f"{ABOUT}.json")


def pack_folder(folder: Path, target: Path) -> int:
    """Make an archive of an unfinished folder and delete the folder; return the rows of the main table.

    The main table's columns have their own names, those of other tables TABLE.COLUMN; ``about`` and ``events`` are
    JSON. Rows that were not written completely are left out.

    Raises
    ------
    OSError, FileError
        If the folder cannot be read or the archive not be written; the folder is then kept.
    """
    about, tables = _known(folder / f"{ABOUT}.json")
    counts = []
    with (
        written_beside(target) as file,  # where there is room: the folder's disk may be full
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION) as archive,
    ):
        for number, table in enumerate(tables):
            rows = mapped(folder / f"{table.name}.rows", len(table.columns))
            counts.append(len(rows))
            for index, (column, kind) in enumerate(zip(table.columns, table.types, strict=True)):
                name = f"{table.name}.{column}" if number else column
                _add(archive, name, rows[:, index], kind)
        _add_text(archive, EVENTS, json.dumps(list(_events(folder / f"{EVENTS}.json"))))
        _add_text(archive, ABOUT, json.dumps(about))
    shutil.rmtree(folder)
    return counts[0]


def mapped(file: Path, width: int) -> FloatArray:
    """Return the whole rows in a file of float64, shape (n, width), without reading them into memory.

    What comes after a hole in the file was never written: a crash can leave one, and a stranger's file may be nothing
    but one.
    """
    if not os.path.lexists(file):
        return np.empty((0, width))
    with open_regular(file, sys.maxsize, follow=False) as stream:
        size = os.fstat(stream.fileno()).st_size
        count = (os.lseek(stream.fileno(), 0, os.SEEK_HOLE) if size else 0) // (8 * width)
        if not count:
            return np.empty((0, width))
        return np.memmap(stream, dtype=np.float64, mode="r", shape=(count, width))


def _known(file: Path) -> tuple[Any, list[Table]]:
    """Return the facts in an unfinished folder, and its tables."""
    try:
        known = parse_json(read_text(file, LARGEST_JSON, follow=False))
        tables = [Table(each["name"], tuple(each["columns"]), tuple(each["types"])) for each in known["tables"]]
        if any(set(table.types) - TYPES.keys() or "/" in table.name for table in tables):
            raise ValueError("its tables have unknown types or names")
        return known["about"], tables
    except (ValueError, KeyError, TypeError) as error:
        raise FileError(f"{file}: damaged: {in_words(error)}") from error


def _events(file: Path) -> Iterator[Any]:
    for line in read_bytes(file, LARGEST_JSON, follow=False).splitlines() if os.path.lexists(file) else ():
        try:
            yield json.loads(line)
        except ValueError:  # the last line, cut off
            return


def _add(archive: zipfile.ZipFile, name: str, column: FloatArray, kind: str) -> None:
    dtype = np.dtype(kind)
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": column.shape}
        np.lib.format.write_array_header_1_0(file, header)
        for start in range(0, len(column), ROWS_AT_ONCE):
            values = column[start : start + ROWS_AT_ONCE]
            file.write(as_type(values, kind).tobytes())


def _add_text(archive: zipfile.ZipFile, name: str, text: str) -> None:
    value: npt.NDArray[np.str_] = np.array(text)
    with archive.open(f"{name}.npy", "w") as file:
        np.lib.format.write_array(file, value, allow_pickle=False)
