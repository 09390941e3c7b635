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
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgpack

from hapticnet.recordings.session.session import Table

_HEADER: Final = struct.Struct("<BIQ")

LARGEST_FRAME: Final = 2**31


class FrameKind(enum.IntEnum):
    """See the module."""

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
class Heading:
    """What is known of a recording when it begins."""

    path: Path  # its suffix is the format
    side: str  # master or slave
    tables: tuple[Table, ...]  # the first is the main one: a row for each tick or step
    unix_offset_us: int  # add it to t_us for µs since 1970
    about: dict[str, Any] = field(default_factory=dict)  # configuration, seed, versions: whatever JSON can hold


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
    tables = tuple(Table(each["name"], tuple(each["columns"]), each["shift_us"]) for each in fields.pop("tables"))
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
