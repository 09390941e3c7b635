"""The tables of a study on disk: one row for each event, written and synced before the next event begins.

A row is one `os.write` of a whole line to a file opened for appending, then an fsync. A crash can leave only
a torn last line, which is dropped when the session continues. Nothing is ever overwritten, and a lock keeps a second
session away; the system releases it when the process ends, however it ends.
"""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, Generic

from hapticnet.documents import LARGEST_DOCUMENT
from hapticnet.errors import FileError, SettingsError
from hapticnet.files import locked, make_folder, open_in_place, open_regular, read_bytes, read_text, replacing
from hapticnet_experiment.rows import AnyRow, OrderRow, columns, from_cells, header, sidecar, to_line
from hapticnet_experiment.weber import ParticipantFile, load_participant

LARGEST_TABLE: Final = 256 * 2**20
SCHEDULE: Final = "schedule.json"
LOCK: Final = ".lock"


class Store(Generic[AnyRow]):
    """The table of one session, with the rows of its earlier runs too. Use `opened`."""

    def __init__(self, path: Path, kind: type[AnyRow], descriptor: int) -> None:
        self.path = path
        self.rows: list[AnyRow] = []
        self._kind = kind
        self._descriptor = descriptor
        self._read()

    def append(self, row: AnyRow) -> None:
        """Write a row and wait until it is on the disk.

        Raise FileError if it cannot be written, for instance because the disk is full: the table is then unchanged.
        """
        self._write(to_line(row))
        self.rows.append(row)

    def _write(self, line: str) -> None:
        data = line.encode()
        before = os.fstat(self._descriptor).st_size
        try:
            written = os.write(self._descriptor, data)
            if written != len(data):
                raise OSError(28, "No space left on device")
            os.fsync(self._descriptor)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._descriptor, before)
            raise FileError(
                f"{self.path}: the last event could not be stored: {error.strerror}; everything before it is safe,"
                " continue with --resume"
            ) from error

    def _read(self) -> None:
        """Read the table; drop a torn last line."""
        size = os.fstat(self._descriptor).st_size
        if size > LARGEST_TABLE:
            raise FileError(f"{self.path}: {size} bytes; a session's table has at most {LARGEST_TABLE}")
        data = os.pread(self._descriptor, size, 0)
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.ftruncate(self._descriptor, whole)
        try:
            lines = data[:whole].decode().splitlines()
        except UnicodeDecodeError as error:
            raise FileError(f"{self.path}: not UTF-8 text: byte {error.start}") from error
        if not lines:
            self._write(header(self._kind))
            return
        self.rows += _rows_of(lines, self._kind, self.path)
        if lines[0] + "\n" != header(self._kind):
            raise FileError(f"{self.path}: written by another version of hapticnet; its columns differ")


def read_table(path: Path, kind: type[AnyRow], *, most: int | None = None) -> list[AnyRow]:
    """Return the rows of a table without changing it, at most `most` of them; a torn last line is omitted."""
    data = read_bytes(path, LARGEST_TABLE)
    lines = data[: data.rfind(b"\n") + 1].decode("utf-8", "replace").splitlines()
    return _rows_of(lines[: None if most is None else 1 + most], kind, path)


def _rows_of(lines: list[str], kind: type[AnyRow], path: Path) -> list[AnyRow]:
    rows = []
    names = lines[0].split("\t") if lines else []
    for number, line in enumerate(lines[1:], start=2):
        try:
            rows.append(from_cells(kind, names, line.split("\t")))
        except FileError as error:
            raise FileError(f"{path}: line {number}: {error}") from error
    return rows


@contextmanager
def opened(
    path: Path,
    kind: type[AnyRow],
    schedule: str,
    *,
    resume: bool,
    levels: Mapping[str, Mapping[str, str]] | None = None,
) -> Iterator[Store[AnyRow]]:
    """Open or make the table of a session, with its schedule and its sidecar (`levels`), and keep other sessions away.

    A continued session keeps its own schedule. Raise SettingsError if the session exists and should not `resume`, or
    another process runs it.
    """
    folder = path.parent
    make_folder(folder)
    with locked(folder / LOCK, SettingsError(f"{folder}: another process runs this session; end it first")):
        if path.exists() and not resume:
            raise SettingsError(f"{path} exists; continue it with --resume, or choose another --session")
        if not path.exists() or not (folder / SCHEDULE).exists():  # a schedule without a table was never used
            _create(folder / SCHEDULE, schedule)
        described = path.with_suffix(".json")
        if not described.exists():
            _create(described, json.dumps(sidecar(kind, levels or {}), indent=1, ensure_ascii=False) + "\n")
        descriptor = open_in_place(path, os.O_APPEND)
        try:
            _sync_folder(folder)
            yield Store(path, kind, descriptor)
        finally:
            os.close(descriptor)


def stored_schedule(folder: Path) -> str | None:
    """Return the schedule with which a session began; None if there is none."""
    path = folder / SCHEDULE
    return read_text(path, LARGEST_DOCUMENT, follow=False) if os.path.lexists(path) else None


def _create(path: Path, text: str) -> None:
    """Write a file that does not exist yet: completely, or not at all."""
    with replacing(path, follow=False, sync=True) as file:
        file.write(text)


def _sync_folder(folder: Path) -> None:
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise FileError(f"{folder}: cannot be written: {error.strerror}") from error


def table_files(folder: Path, kind: type[AnyRow]) -> list[Path]:
    """Return the tables of a kind in a folder and below, in order of their names.

    Raise FileError if the folder does not exist, or a table has a column that no session writes.
    """
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder")
    mark = "order_true" if kind is OrderRow else "reference_n"
    found = []
    for file in sorted(folder.rglob("*.tsv")):
        with open_regular(file) as lines:
            names = lines.readline(100_000).decode(errors="replace").rstrip("\r\n").split("\t")
        if mark not in names or "event" not in names:
            continue
        strange = [name for name in names if name not in columns(kind)]
        if strange or len(set(names)) < len(names):
            which = f'the column "{strange[0][:40]}"' if strange else "a column twice"
            raise FileError(f"{file}: has {which}, which no session writes: changed, or written by another version")
        found.append(file)
    return found


def read_rows(folder: Path, kind: type[AnyRow]) -> list[AnyRow]:
    """Return the rows of every table of a kind in a folder and below, table by table.

    Raise FileError if a table cannot be read, or two tables have the same session of a participant.
    """
    found: list[AnyRow] = []
    tables: dict[tuple[str, int], Path] = {}
    for file in table_files(folder, kind):
        rows = read_table(file, kind)
        for session in dict.fromkeys((row.participant, row.session) for row in rows):
            if session in tables:
                raise FileError(
                    f"{tables[session]} and {file} both have session {session[1]} of participant {session[0]};"
                    " keep one of them, or name the folder of one"
                )
            tables[session] = file
        found += rows
    return found


def read_people(folder: Path) -> list[ParticipantFile]:
    """Return the measured JND of each participant, from ``participants/*.toml`` in a folder and below."""
    return [load_participant(file) for file in sorted(folder.rglob("participants/*.toml"))]
