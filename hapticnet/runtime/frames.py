"""Frames on the pipe from a node's process to a process beside it: kind, length, body."""

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

HEADER: Final = struct.Struct("<BI")
"""What precedes a body: its kind and its length [bytes]."""


def pack_frame(kind: int, body: bytes) -> bytes:
    """Return a frame; `kind` (0 to 255) says what the body is."""
    return HEADER.pack(kind, len(body)) + body


def read_frames(stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each frame until the writer has gone; an incomplete last frame is left out."""
    while len(header := stream.read(HEADER.size)) == HEADER.size:
        kind, length = HEADER.unpack(header)
        body = stream.read(length)
        if len(body) < length:
            return
        yield kind, body
