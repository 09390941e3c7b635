"""Recordings turned into other formats."""

import json
import struct
from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.errors import FileError, UnavailableError
from hapticnet.files import written_beside
from hapticnet.recordings.session.archive import FORMATS
from hapticnet.recordings.session.csv_writer import beside
from hapticnet.recordings.session.frames import Heading, Table
from hapticnet.recordings.session.session import INCOMPLETE, REPORT, Session, SessionTable

ROWS_AT_ONCE: Final = 10_000
NEEDS_PYARROW: Final = "Parquet files need pyarrow (extra parquet): pip install pyarrow"


def export(session: Session, path: Path) -> None:
    """Write a recording as .csv, .npz, .mcap or .parquet, whatever the suffix says.

    Raises
    ------
    FileError
        If it cannot be written, or has times that the format has not.
    UnavailableError
        If the format needs an extra.
    """
    try:
        if path.suffix.lower() == ".parquet":
            _write_parquet(session, path)
        else:
            _write(session, path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error
    except struct.error as error:
        raise FileError(f"{path}: MCAP has no times before 1970 or after 2554, and this recording has") from error


def exported_files(path: Path) -> list[Path]:
    """Return the files that `export` may write."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return [path, *(beside(path, what) for what in ("datagrams.csv", "events.csv", "about.json"))]
    if suffix == ".parquet":
        return [path, *(beside(path, what) for what in ("datagrams.parquet", "events.parquet"))]
    return [path]


def _write(session: Session, path: Path) -> None:
    tables = tuple(Table.of(name, tuple(columns)) for name, columns in session.tables.items())
    about = {name: value for name, value in _about(session).items() if name != REPORT}
    heading = Heading(path, session.side, tables, session.unix_offset_us, about)
    writer = FORMATS[path.suffix.lower()](heading)
    for event in session.events:
        writer.event(*event)
    for index, columns in enumerate(session.tables.values()):
        rows = np.stack([column.astype(np.float64) for column in columns.values()], axis=1)
        for start in range(0, len(rows), ROWS_AT_ONCE):
            writer.rows(index, rows[start : start + ROWS_AT_ONCE])
            writer.flush()
    writer.finish({REPORT: session.about[REPORT]} if REPORT in session.about else {})


def _about(session: Session) -> dict[str, Any]:
    why = {} if session.is_whole else {INCOMPLETE: "the file from which it was exported was cut off or damaged"}
    return session.about | why


def _write_parquet(session: Session, path: Path) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UnavailableError(NEEDS_PYARROW) from error
    about: dict[str, Any] = {**_about(session), "side": session.side, "unix_offset_us": session.unix_offset_us}
    tables: dict[Path, SessionTable | dict[str, Any]] = {}
    for number, (name, columns) in enumerate(session.tables.items()):
        tables[beside(path, f"{name}s.parquet") if number else path] = columns
    if session.events:
        t_us, names, texts = zip(*session.events, strict=True)
        tables[beside(path, "events.parquet")] = {"t_us": t_us, "event": names, "text": texts}
    for file, columns in tables.items():
        table = pyarrow.table(dict(columns)).replace_schema_metadata({"hapticnet": json.dumps(about)})
        with written_beside(file) as stream:
            pyarrow.parquet.write_table(table, stream)
