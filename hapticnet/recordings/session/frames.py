"""What a process tells the writer of its recordings: frames on a pipe.

A frame is a header (kind, number of the recording, size of the rest, little-endian) and the rest:

BEGIN
    a msgpack map, the fields of `Heading`
ROWS
    one byte, the number of the table, then rows of float64 in the machine's byte order
EVENT
    a msgpack array [t_us, name, text]
ABOUT
    a msgpack map, added to `Heading.about`
END
    nothing: the recording is complete
"""

import enum
import struct
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgpack
import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray

_HEADER: Final = struct.Struct("<BIQ")

LARGEST_FRAME: Final = 2**31

INTEGERS: Final = {
    "t_us": "i8",
    "answered_us": "i8",
    "transmitted": "i4",
    "datagram_bytes": "i4",
    "breaches": "i4",
    "direction": "i4",
    "kind": "i4",
}
"""Columns that hold whole numbers, and their types; all others are float64."""


def as_type(values: FloatArray, kind: str) -> npt.NDArray[Any]:
    """Return values in the type of their column. Whole numbers have -1 for NaN, and end at what the type can hold."""
    dtype = np.dtype(kind)
    if dtype.kind == "f":
        return values.astype(dtype)
    least, most = float(np.iinfo(dtype).min), float(np.iinfo(dtype).max)
    if int(most) > np.iinfo(dtype).max:  # float64 has no 2**63 - 1
        most = float(np.nextafter(most, 0.0))
    return np.clip(np.nan_to_num(values, nan=-1.0, posinf=most, neginf=least), least, most).astype(dtype)


class FrameKind(enum.IntEnum):
    """See above."""

    BEGIN = 1
    ROWS = 2
    EVENT = 3
    ABOUT = 4
    END = 5


class Frame(NamedTuple):
    """One frame; `content` is what follows the header."""

    kind: FrameKind
    recording: int
    content: bytes


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a recording.

    Attributes
    ----------
    name
        ``tick``, ``step`` or ``datagram``; the topic is ``/SIDE/NAME``.
    columns
        Names with units; the first is ``t_us``.
    types
        NumPy's name of each column's type.
    shift_us
        Added to `t_us` when a row is written, so that all tables have the master's clock.
    """

    name: str
    columns: tuple[str, ...]
    types: tuple[str, ...]
    shift_us: int = 0

    @classmethod
    def of(cls, name: str, columns: Sequence[str], *, shift_us: int = 0) -> "Table":
        """Return a table whose columns are float64, except for those in `INTEGERS`."""
        return cls(name, tuple(columns), tuple(INTEGERS.get(column, "f8") for column in columns), shift_us)


@dataclass(frozen=True, slots=True)
class Heading:
    """What is known of a recording when it begins.

    Attributes
    ----------
    path
        The file. Its suffix is the format.
    side
        ``master`` or ``slave``.
    tables
        The first is the main one: a row for each tick or step.
    unix_offset_us
        Add it to `t_us` for µs since 1970.
    about
        Configuration, seed, versions: whatever JSON can hold.
    """

    path: Path
    side: str
    tables: tuple[Table, ...]
    unix_offset_us: int
    about: dict[str, Any] = field(default_factory=dict)


def pack_frame(kind: FrameKind, recording: int, content: bytes = b"") -> bytes:
    """Return a frame as bytes."""
    return _HEADER.pack(kind, recording, len(content)) + content


def pack_begin(recording: int, heading: Heading) -> bytes:
    """Return the frame with which a recording begins."""
    fields = asdict(heading) | {"path": str(heading.path)}
    return pack_frame(FrameKind.BEGIN, recording, msgpack.packb(fields, default=str))


def pack_rows_header(recording: int, table: int, size: int) -> bytes:
    """Return what precedes `size` bytes of rows on the pipe."""
    return _HEADER.pack(FrameKind.ROWS, recording, size + 1) + bytes([table])


def unpack_heading(content: bytes) -> Heading:
    """Return the heading in a BEGIN frame."""
    fields = msgpack.unpackb(content)
    tables = tuple(
        Table(each["name"], tuple(each["columns"]), tuple(each["types"]), each["shift_us"])
        for each in fields.pop("tables")
    )
    return Heading(path=Path(fields.pop("path")), tables=tables, **fields)


class FrameReader:
    """Cut a stream of bytes into frames."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Add bytes, and yield the frames that are complete now.

        Raises
        ------
        ValueError
            If the bytes are not frames; nothing later can be read.
        """
        self._buffer += data
        at = 0
        try:
            while len(self._buffer) - at >= _HEADER.size:
                kind, recording, size = _HEADER.unpack_from(self._buffer, at)
                if size > LARGEST_FRAME:
                    raise ValueError(f"a frame of {size} bytes")
                end = at + _HEADER.size + size
                if end > len(self._buffer):
                    break
                yield Frame(FrameKind(kind), recording, bytes(self._buffer[at + _HEADER.size : end]))
                at = end
        finally:
            del self._buffer[:at]
