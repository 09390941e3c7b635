"""Recordings converted to other formats."""

import json
import struct
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.errors import FileError
from hapticnet.files import written_beside
from hapticnet.recordings.session.archive import FORMATS
from hapticnet.recordings.session.frames import Heading
from hapticnet.recordings.session.session import INCOMPLETE, INTEGERS, REPORT, Session, Table, as_type
from hapticnet.recordings.session.sink import beside

ROWS_AT_ONCE: Final = 10_000


def export(session: Session, path: Path) -> None:
    """Write a recording as its suffix says; FileError if that cannot be, UnavailableError without an extra."""
    why = {} if session.is_whole else {INCOMPLETE: "the source file was cut off or damaged"}
    about: dict[str, Any] = {**session.about, **why}
    known = {**about, "side": session.side, "unix_offset_us": session.unix_offset_us}
    try:
        if path.suffix.lower() == ".npz":
            _write_npz(session, path, json.dumps(known, default=str))
        else:
            _write(session, path, about)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error
    except struct.error as error:
        raise FileError(f"{path}: MCAP has no times before 1970 or after 2554, and this recording has") from error


def exported_files(path: Path) -> list[Path]:
    """Return the files that `export` may write."""
    others = ("datagrams.csv", "vibrations.csv", "events.csv", "about.json") if path.suffix.lower() == ".csv" else ()
    return [path, *(beside(path, what) for what in others)]


def _write(session: Session, path: Path, about: dict[str, Any]) -> None:
    tables = tuple(Table(name, tuple(columns)) for name, columns in session.tables.items())
    report = {REPORT: about.pop(REPORT)} if REPORT in about else {}
    writer = FORMATS[path.suffix.lower()](Heading(path, session.side, tables, session.unix_offset_us, about))
    try:
        for event in session.events:
            writer.event(*event)
        for index, columns in enumerate(session.tables.values()):
            rows = np.stack([column.astype(np.float64) for column in columns.values()], axis=1)
            for start in range(0, len(rows), ROWS_AT_ONCE):
                writer.rows(index, rows[start : start + ROWS_AT_ONCE])
                writer.flush()
        writer.finish(report)
    except BaseException:
        for sink in writer.files:
            sink.discard()
        raise


def _write_npz(session: Session, path: Path, known: str) -> None:
    """Write the main table's columns by name, other tables' as TABLE.COLUMN, and texts of JSON."""
    arrays: dict[str, Any] = {"about": np.array(known), "events": np.array(json.dumps(session.events))}
    for number, (table, columns) in enumerate(session.tables.items()):
        for name, column in columns.items():
            arrays[f"{table}.{name}" if number else name] = as_type(column, INTEGERS.get(name, "f8"))
    with written_beside(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
