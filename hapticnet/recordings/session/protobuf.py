"""Rows of numbers as Protocol Buffers: the descriptor of a message and its bytes, packed without a protobuf library.

Every field has a fixed size, so all messages of a table have the same length, and NumPy packs and reads many at once.
Sources: protobuf.dev/programming-guides/encoding, google/protobuf/descriptor.proto.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray

PACKAGE: Final = "hapticnet"

TYPES: Final = {"f8": (1, 1), "i8": (16, 1), "i4": (15, 5)}
"""NumPy's name of a type: number in ``FieldDescriptorProto.Type`` (double, sfixed64, sfixed32), and wire type."""

_STRING: Final = 9
_OPTIONAL: Final = 1
_LENGTH_DELIMITED: Final = 2


def varint(number: int) -> bytes:
    """Return a number ≥ 0 as a base-128 varint."""
    parts = bytearray()
    while number > 0x7F:
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    parts.append(number)
    return bytes(parts)


def descriptor(message: str, fields: Sequence[tuple[str, int]]) -> bytes:
    """Return a packed ``FileDescriptorSet`` with one message.

    Parameters
    ----------
    fields
        Name and type of each field; field numbers count from 1.
    """
    packed = b"".join(
        _field(2, _text(1, name) + _number(3, number) + _number(4, _OPTIONAL) + _number(5, kind) + _text(10, name))
        for number, (name, kind) in enumerate(fields, start=1)
    )
    file = _text(1, f"{message.lower()}.proto") + _text(2, PACKAGE) + _field(4, _text(1, message) + packed)
    return _field(1, file + _text(12, "proto3"))


def row_descriptor(message: str, columns: Sequence[str], types: Sequence[str]) -> bytes:
    """Return the descriptor of a message with a field for each column."""
    return descriptor(message, [(name, TYPES[kind][0]) for name, kind in zip(columns, types, strict=True)])


def row_dtype(types: Sequence[str]) -> npt.DTypeLike:
    """Return the structured type of a packed message: for each field its tag and then its value ``v0``, ``v1``, …."""
    parts: list[tuple[str, str]] = []
    for index, kind in enumerate(types):
        parts += [(f"t{index}", f"S{len(_tag(index, kind))}"), (f"v{index}", f"<{kind}")]
    return np.dtype(parts)


def pack_rows(rows: FloatArray, types: Sequence[str]) -> npt.NDArray[Any]:
    """Return rows of shape (n, columns) as n messages: a structured array of `row_dtype`."""
    packed = np.empty(len(rows), dtype=row_dtype(types))
    for index, kind in enumerate(types):
        values = rows[:, index]
        packed[f"t{index}"] = _tag(index, kind)
        packed[f"v{index}"] = values if kind == "f8" else np.nan_to_num(values, nan=-1.0)
    return packed


def event_descriptor(message: str) -> bytes:
    """Return the descriptor of an event: t_us, event, text."""
    return descriptor(message, [("t_us", TYPES["i8"][0]), ("event", _STRING), ("text", _STRING)])


def pack_event(t_us: int, name: str, text: str) -> bytes:
    """Return an event as a message."""
    return _tag(0, "i8") + t_us.to_bytes(8, "little", signed=True) + _text(2, name) + _text(3, text)


def unpack_event(data: bytes) -> tuple[int, str, str]:
    """Return time, name and text of an event; ValueError if it was not packed by `pack_event`."""
    if len(data) < 9 or data[:1] != _tag(0, "i8"):
        raise ValueError("not an event")
    texts = []
    at = 9
    for _ in range(2):
        _, at = _read_varint(data, at)
        size, at = _read_varint(data, at)
        if at + size > len(data):
            raise ValueError("a text reaches past the end of its message")
        texts.append(data[at : at + size].decode(errors="replace"))
        at += size
    return int.from_bytes(data[1:9], "little", signed=True), texts[0], texts[1]


def _tag(index: int, kind: str) -> bytes:
    return varint((index + 1) << 3 | TYPES[kind][1])


def _field(number: int, content: bytes) -> bytes:
    return varint(number << 3 | _LENGTH_DELIMITED) + varint(len(content)) + content


def _text(number: int, text: str) -> bytes:
    return _field(number, text.encode())


def _number(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the varint at a place, and the place after it."""
    number = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise ValueError("a number reaches past the end of its message")
        byte = data[at]
        number |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return number, at
