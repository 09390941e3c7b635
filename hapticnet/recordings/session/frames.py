"""Frames for the writer of recordings: msgpack arrays on a pipe, [kind, number of the recording, …]."""

import enum
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import msgpack

from hapticnet.recordings.session.session import Table

LARGEST_FRAME: Final = 2**31 - 1


class FrameKind(enum.IntEnum):
    """Contents of a frame after its kind and the number of the recording."""

    BEGIN = 1  # the fields of `Heading` as a map
    ROWS = 2  # the number of the table, and rows of float64 in the machine's byte order
    EVENT = 3  # time [µs], name and text
    ABOUT = 4  # a map, added to `Heading.about`
    END = 5  # nothing: the recording is complete


@dataclass(frozen=True, slots=True)
class Heading:
    """Facts of a recording at its start."""

    path: Path  # its suffix is the format
    side: str  # master or slave
    tables: tuple[Table, ...]  # the first is the main one: a row for each tick or step
    unix_offset_us: int  # add it to t_us for µs since 1970
    about: dict[str, Any] = field(default_factory=dict)  # configuration, seed, versions: anything that JSON can hold

    @classmethod
    def of(cls, fields: dict[str, Any]) -> "Heading":
        """Return the heading in a BEGIN frame."""
        tables = tuple(Table(each["name"], tuple(each["columns"]), each["shift_us"]) for each in fields["tables"])
        return cls(**fields | {"path": Path(fields["path"]), "tables": tables})


def pack_frame(kind: FrameKind, recording: int, *content: Any) -> bytes:
    """Return a frame as bytes."""
    packed: bytes = msgpack.packb((kind, recording, *content), default=str)
    return packed


def pack_begin(recording: int, heading: Heading) -> bytes:
    """Return the frame with which a recording begins."""
    return pack_frame(FrameKind.BEGIN, recording, asdict(heading))


def pack_rows_header(recording: int, table: int, size: int) -> bytes:
    """Return the header of `size` bytes of rows on the pipe."""
    head = (FrameKind.ROWS, recording, table)
    return b"".join((b"\x94", *map(msgpack.packb, head), b"\xc6", size.to_bytes(4, "big")))


def frame_reader() -> msgpack.Unpacker:
    """Return a splitter of bytes into frames: `feed` it, and iterate over the complete ones."""
    return msgpack.Unpacker(max_buffer_size=LARGEST_FRAME)
