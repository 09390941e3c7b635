"""Rows of numbers as Protocol Buffers of a fixed size, so that NumPy packs and reads many at once, without protobuf.

Sources: protobuf.dev/programming-guides/encoding, google/protobuf/descriptor.proto.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.recordings.session.session import as_type

PACKAGE: Final = "hapticnet"
TYPES: Final = {"f8": (1, 1), "i8": (16, 1), "i4": (15, 5)}  # number in ``FieldDescriptorProto.Type``, and wire type
LOG: Final = "foxglove.Log"  # the message that Foxglove shows in its panel of logs
LEVELS: Final = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
_INT64, _INT32, _FIXED32, _STRING, _MESSAGE, _ENUM = 3, 5, 7, 9, 11, 14
_UINT64: Final = 2**64 - 1
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


def row_descriptor(message: str, columns: Sequence[str], types: Sequence[str]) -> bytes:
    """Return a packed ``FileDescriptorSet`` of a message with a field for each column."""
    fields = [(name, TYPES[kind][0]) for name, kind in zip(columns, types, strict=True)]
    return _file(f"{message.lower()}.proto", PACKAGE, _field(4, _message(message, *fields)))


def row_dtype(types: Sequence[str]) -> np.dtype[Any]:
    """Return the structured type of a packed message: for each field its tag and then its value ``v0``, ``v1``, …."""
    parts: list[tuple[str, str]] = []
    for index, kind in enumerate(types):
        parts += [(f"t{index}", f"S{len(_tag(index, kind))}"), (f"v{index}", f"<{kind}")]
    return np.dtype(parts)


def pack_rows(rows: FloatArray, types: Sequence[str]) -> npt.NDArray[Any]:
    """Return rows of shape (n, columns) as n messages: a structured array of `row_dtype`."""
    packed = np.empty(len(rows), dtype=row_dtype(types))
    for index, kind in enumerate(types):
        packed[f"t{index}"] = _tag(index, kind)
        packed[f"v{index}"] = as_type(rows[:, index], kind)
    return packed


def log_descriptor() -> bytes:
    """Return the descriptor of `LOG`, with its imports. Source: Foxglove's schemas/proto/foxglove/Log.proto."""
    time = _message("Timestamp", ("seconds", _INT64), ("nanos", _INT32))
    log = _message(
        "Log",
        ("timestamp", _MESSAGE, ".google.protobuf.Timestamp"),
        ("level", _ENUM, ".foxglove.LogLevel"),
        ("message", _STRING),
        ("name", _STRING),
        ("file", _STRING),
        ("line", _FIXED32),
    )
    levels = b"".join(_field(2, _text(1, name) + _number(2, number)) for number, name in enumerate(LEVELS))
    needed = "google/protobuf/timestamp.proto", "foxglove/LogLevel.proto"
    return b"".join(
        (
            _file(needed[0], "google.protobuf", _field(4, time)),
            _file(needed[1], "foxglove", _field(5, _text(1, "LogLevel") + levels)),
            _file("foxglove/Log.proto", "foxglove", b"".join(_text(3, each) for each in needed) + _field(4, log)),
        )
    )


def pack_log(time_ns: int, level: str, name: str, message: str) -> bytes:
    """Return a `LOG`; its time is in ns since 1970."""
    seconds, nanos = divmod(time_ns, 10**9)
    stamp = _number(1, seconds & _UINT64) + _number(2, nanos)
    return _field(1, stamp) + _number(2, LEVELS.index(level)) + _text(3, message) + _text(4, name)


def unpack_log(data: bytes) -> tuple[int, str, str]:
    """Return time [ns], name and message of a `LOG`; ValueError if it was not packed by `pack_log`."""
    fields = _read_fields(data)
    stamp, message, name = (fields.get(number) for number in (1, 3, 4))
    if not (isinstance(stamp, bytes) and isinstance(message, bytes) and isinstance(name, bytes)):
        raise ValueError("not an event")
    seconds, nanos = (_read_fields(stamp).get(number) for number in (1, 2))
    if not (isinstance(seconds, int) and isinstance(nanos, int)):
        raise ValueError("an event without a time")
    signed = seconds - (_UINT64 + 1) * (seconds >> 63)
    return 10**9 * signed + nanos, name.decode(errors="replace"), message.decode(errors="replace")


def _read_fields(data: bytes) -> dict[int, int | bytes]:
    """Return the fields of a message by their numbers: varints and length-delimited ones."""
    fields: dict[int, int | bytes] = {}
    at = 0
    while at < len(data):
        tag, at = _read_varint(data, at)
        value, at = _read_varint(data, at)
        fields[tag >> 3] = value
        if tag & 7 == _LENGTH_DELIMITED:
            if at + value > len(data):
                raise ValueError("a text reaches past the end of its message")
            fields[tag >> 3] = data[at : at + value]
            at += value
        elif tag & 7:
            raise ValueError("a field of an unknown kind")
    return fields


def _message(name: str, *fields: tuple[str, int] | tuple[str, int, str]) -> bytes:
    """Return the descriptor of a message: name, type and type name of each field; field numbers count from 1."""
    packed = b"".join(
        _field(
            2,
            _text(1, field) + _number(3, number) + _number(4, _OPTIONAL) + _number(5, kind)
            + b"".join(_text(6, each) for each in of_what) + _text(10, field),
        )
        for number, (field, kind, *of_what) in enumerate(fields, start=1)
    )  # fmt: skip
    return _text(1, name) + packed


def _file(name: str, package: str, content: bytes) -> bytes:
    return _field(1, _text(1, name) + _text(2, package) + content + _text(12, "proto3"))


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
