"""Recognise the kind of a recording's file by its first bytes, and open it."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeAlias

from hapticnet.errors import FileError
from hapticnet.files import check_readable, file_errors
from hapticnet.recordings.arrays import ArraySource, open_mat, open_npy, open_npz
from hapticnet.recordings.session.reading import check_main, csv_events, read_session
from hapticnet.recordings.session.session import change_notes
from hapticnet.recordings.session.sink import beside
from hapticnet.recordings.text import TextSource

Source: TypeAlias = ArraySource | TextSource  # a file's columns
_READABLE: Final = "CSV, TSV, .npy, .npz, .mat, and hapticnet's own .mcap can be read"


def open_session(path: Path, max_bytes: int) -> ArraySource:
    """Return the main table of a recording of hapticnet as columns."""
    session = read_session(path, max_bytes=max_bytes)
    columns = session.main
    source = ArraySource(path, list(columns), lambda names: [columns[name] for name in names], len(columns["t_us"]))
    source.notes = change_notes(session.events)
    return source


def open_text(path: Path, _max_bytes: int) -> TextSource:
    """Return a text table as columns; if hapticnet recorded it, its events are beside it."""
    source = TextSource(path)
    if beside(path, "about.json").exists() and source.names[0] == "t_us":
        source.notes = (*source.notes, *change_notes(csv_events(beside(path, "events.csv"))))
    return source


_READERS: Final[dict[str, Callable[[Path, int], Source]]] = {
    "a NumPy array": open_npy,
    "a NumPy archive": open_npz,
    "a MATLAB file": open_mat,
    "an MCAP file": open_session,
    "a recording": open_session,
    "a text table": open_text,
}

_COMPRESSED: Final = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0", b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf\x27\x1c")
_KINDS: Final = (
    (b"\x93NUMPY", "a NumPy array", ""),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file", ""),
    (b"PAR1", "a Parquet file", "save it as CSV or .npz"),
    (b"\x89MCAP", "an MCAP file", ""),
    (b"MATLAB 7.3 MAT-file", "a MATLAB v7.3 file (HDF5)", "save it with '-v7'"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", "export it as CSV or .npz"),
    (b"#ROSBAG V", "a ROS bag", "export it as CSV"),
    (b"SQLite format 3\0", "an SQLite database, such as a ROS 2 bag", "export it as CSV"),
    (b"ARROW1", "an Arrow file (Feather)", "save it as CSV or .npz"),
    (b"TDSm", "a LabVIEW TDMS file", "export it as CSV"),
    *((magic, "a compressed file", "unpack it first") for magic in _COMPRESSED),
    (b"\xd0\xcf\x11\xe0", "a Microsoft Office file, such as .xls", "save it as CSV"),
)
_HEAD_BYTES: Final = 4096
_TEXT_CONTROLS: Final = b"\t\n\v\f\r\x1b"


def open_source(path: Path, max_bytes: int) -> Source:
    """Open a recording of any kind; FileError if it cannot be read, UnavailableError if that needs another package."""
    check_readable(path, max_bytes)
    check_main(path)
    with file_errors(path):
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        kind = kind_of(path, head)
        return _READERS[kind](path, max_bytes)


def kind_of(path: Path, head: bytes) -> str:
    """Return the kind of a file, from its first bytes; raise FileError with its name if it cannot be read."""
    if head.startswith(b"PK"):
        return _kind_of_zip(path)
    for magic, kind, advice in _KINDS:
        if head.startswith(magic):
            if kind in _READERS:
                return kind
            raise FileError(f"{path}: {kind}; {advice or _READABLE}")
    if path.suffix.lower() == ".mat":  # v4 has no magic number
        return "a MATLAB file"
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "a text table"
    controls = sum(byte < 32 and byte not in _TEXT_CONTROLS for byte in head)
    valid = _is_utf8(head)
    if path.suffix.lower() in (".npy", ".npz"):
        raise FileError(f"{path}: not a {path.suffix.lower()} file{', but text' if valid and not controls else ''}")
    if controls and (not valid or controls > len(head) / 10):
        raise FileError(f"{path}: a binary file of an unknown kind; {_READABLE}")
    return "a text table"


def _kind_of_zip(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.namelist()
    except Exception as error:
        raise FileError(f"{path}: a damaged zip archive") from error
    if {"about.npy", "events.npy"} <= set(members):
        return "a recording"
    if any(member.endswith(".npy") for member in members):
        return "a NumPy archive"
    if any(member.startswith("xl/") for member in members):
        raise FileError(f"{path}: an Excel workbook; save it as CSV")
    raise FileError(f"{path}: a zip archive without NumPy arrays; unpack it first")


def _is_utf8(head: bytes) -> bool:
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return error.end == len(head) == _HEAD_BYTES  # cut within a character
    return True
