"""Read hapticnet's recordings in any format."""

import csv
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import FileError
from hapticnet.files import MAX_BYTES, check_readable, file_errors, read_text
from hapticnet.recordings.arrays import load_npz
from hapticnet.recordings.session.mcap_reader import read_mcap
from hapticnet.recordings.session.session import (
    INTEGERS,
    LARGEST_JSON,
    Event,
    Session,
    SessionTable,
    as_type,
    check_events,
    parse_json,
)
from hapticnet.recordings.session.sink import UNFINISHED, beside, named
from hapticnet.recordings.text import TextSource

LATEST_US: Final = 100_000_000_000_000_000  # largest plausible time [µs], on any clock: 3,000 years
MOST_TABLES: Final = 16  # most tables of a recording; hapticnet writes up to three
_TABLE: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")
_MCAP_MAGIC: Final = b"\x89MCAP"
_ZIP_MAGIC: Final = b"PK"
_OTHER_TABLES: Final = ("datagram", "vibration")
_NO_RECORDING: Final = "not a recording of hapticnet"
_BESIDE: Final = (*(f".{name}s.csv" for name in _OTHER_TABLES), ".events.csv", ".about.json")


class ForeignError(FileError):
    """The file is not damaged, but another program's."""


def read_session(path: Path, *, max_bytes: int = MAX_BYTES) -> Session:
    """Return a recording that a master or slave wrote; of a truncated .mcap file, the undamaged part.

    Raise FileError if it cannot be read, or unpacks to more than `max_bytes`; UnavailableError if it needs an extra.
    """
    unfinished = path.parent / (path.name + UNFINISHED)
    if not path.exists() and unfinished.exists():
        raise FileError(f"{path} is not complete: run 'hapticnet export {unfinished}'")
    check_readable(path, max_bytes)
    with file_errors(path):
        return _checked(path, _reader(path)(path, max_bytes))


def _reader(path: Path) -> Callable[[Path, int], Session]:
    with path.open("rb") as file:
        magic = file.read(8)
    if magic.startswith(_MCAP_MAGIC):
        return read_mcap
    if magic.startswith(_ZIP_MAGIC):
        return _read_npz
    check_main(path)
    sidecar = _part(path, "about.json")
    if not sidecar.exists():
        raise ForeignError(
            f"{path}: {_NO_RECORDING}: that is a .mcap or .npz file, or a .csv file with {sidecar.name} beside it"
        )
    return _read_csv


def _part(path: Path, what: str) -> Path:
    """Return a part of a CSV recording. The main one is renamed last, so others may have their last name before it."""
    parts_are_renamed = not beside(path, "about.json").exists()
    return beside(named(path) if parts_are_renamed and not beside(path, what).exists() else path, what)


def check_main(path: Path) -> None:
    """Raise FileError if a file is a part of a CSV recording beside its main file, such as its events."""
    for end in _BESIDE:
        main = path.with_name(f"{path.name.removesuffix(end)}.csv")
        if path.name.endswith(end) and main.exists() and beside(main, "about.json").exists():
            raise FileError(f"{path}: a part of a recording; name its main file, {main}")


def _checked(path: Path, session: Session) -> Session:
    """Return a recording with checked tables; raise FileError if they are damaged."""
    if len(session.tables) > MOST_TABLES:
        raise FileError(f"{path}: {len(session.tables)} tables; a recording has at most {MOST_TABLES}")
    for name, columns in session.tables.items():
        if not _TABLE.fullmatch(name):  # it becomes part of file names
            raise FileError(f"{path}: damaged: {name[:60]!r} is not a valid name of a table")
        if "t_us" not in columns:
            raise FileError(f"{path}: damaged: its table of {name}s has no times")
        for column in columns.values():
            if column.ndim != 1 or column.dtype.kind not in "if" or len(column) != len(columns["t_us"]):
                raise FileError(f"{path}: damaged: the columns of its table of {name}s do not match")
        t_us = columns["t_us"]
        if len(t_us) and not (t_us.min() >= -LATEST_US and t_us.max() <= LATEST_US):
            raise FileError(f"{path}: damaged: the times of its table of {name}s are out of range")
    if abs(session.unix_offset_us) > LATEST_US:
        return replace(session, unix_offset_us=0)
    return session


def _read_npz(path: Path, max_bytes: int) -> Session:
    columns = load_npz(path, max_bytes)
    try:
        about = parse_json(str(columns.pop("about")))
        listed = parse_json(str(columns.pop("events")))
        check_events(path, len(listed))
        events = tuple(Event(int(t_us), str(name), str(text)) for t_us, name, text in listed)
        side, offset_us = str(about.pop("side")), int(about.pop("unix_offset_us"))
    except KeyError as error:
        raise ForeignError(f"{path}: {_NO_RECORDING}; its arrays are {', '.join(list(columns)[:20])}") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FileError(f"{path}: {_NO_RECORDING} that can be read: {error}") from error
    tables: dict[str, dict[str, Any]] = {_main_name(side): {}}
    for name, column in columns.items():
        table, _, short = name.rpartition(".")
        tables.setdefault(table or _main_name(side), {})[short] = column
    return Session(side, about, offset_us, dict(tables), events)


def _read_csv(path: Path, max_bytes: int) -> Session:
    sidecar = _part(path, "about.json")
    try:
        about = parse_json(read_text(sidecar, LARGEST_JSON))
        side, offset_us = str(about.pop("side")), int(about.pop("unix_offset_us"))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FileError(f"{sidecar}: {_NO_RECORDING}") from error
    tables = {_main_name(side): _csv_table(path, max_bytes)}
    for name in _OTHER_TABLES:
        other = _part(path, f"{name}s.csv")
        if other.exists():
            tables[name] = _csv_table(other, max_bytes)
    return Session(side, about, offset_us, tables, csv_events(_part(path, "events.csv")))


def _csv_table(path: Path, max_bytes: int) -> SessionTable:
    check_readable(path, max_bytes)
    source = TextSource(path, torn=named(path) != path)
    values = source.numbers(range(len(source.names)))
    return {name: as_type(values[:, index], INTEGERS.get(name, "f8")) for index, name in enumerate(source.names)}


def csv_events(path: Path) -> tuple[Event, ...]:
    """Return the events of a CSV recording, none if there is no such file; raise FileError if they are damaged."""
    if not path.exists():
        return ()
    lines = read_text(path, LARGEST_JSON).splitlines(keepends=True)
    if lines and named(path) != path and not lines[-1].endswith("\n"):  # its writer was killed
        lines.pop()
    rows = list(csv.reader(lines))[1:]
    check_events(path, len(rows))
    try:
        return tuple(Event(int(t_us), name, text) for t_us, name, text in rows)
    except ValueError as error:
        raise FileError(f"{path}: not the events of a recording: {error}") from error


def _main_name(side: str) -> str:
    return "tick" if side == "master" else "step"
