"""What the smallest peers need of msgpack; a library for msgpack does the same."""

import struct
from typing import Any

NUMBERS = dict(zip((0xCA, 0xCB, *range(0xCC, 0xD4)), "fdBHIQbhiq", strict=True))
SIZES = {0xC4: ("B", bytes), 0xC5: ("H", bytes), 0xD9: ("B", str), 0xDC: ("H", list)}


def packb(value: Any) -> bytes:
    """Return a value as bytes. Text may have 31 bytes, and an integer must not be negative."""
    if value is None or isinstance(value, bool):
        return b"\xc0" if value is None else bytes([0xC2 + value])
    if isinstance(value, int):
        form = next(form for form in range(4) if value < 256 ** (1 << form))
        return bytes([value]) if value < 128 else bytes([0xCC + form]) + value.to_bytes(1 << form, "big")
    if isinstance(value, float):
        return struct.pack(">Bd", 0xCB, value)
    if isinstance(value, str):
        return bytes([0xA0 + len(value.encode())]) + value.encode()
    if isinstance(value, bytes):
        return (
            struct.pack(">BB", 0xC4, len(value)) if len(value) < 256 else struct.pack(">BH", 0xC5, len(value))
        ) + value
    parts = [each for item in value.items() for each in item] if isinstance(value, dict) else value
    return bytes([(0x80 if isinstance(value, dict) else 0x90) + len(value)]) + b"".join(map(packb, parts))


def unpackb(data: bytes) -> Any:
    """Return the value in `data`; raise one of UNREADABLE if there is none."""
    value, end = _read(data, 0)
    if end != len(data):
        raise ValueError("it ends early, or goes on")
    return value


def _read(data: bytes, at: int) -> tuple[Any, int]:
    head, at = data[at], at + 1
    if head < 0x80 or head >= 0xE0:
        return head if head < 0x80 else head - 0x100, at
    if head in (0xC0, 0xC2, 0xC3):
        return (None, False, True)[max(head - 0xC1, 0)], at
    form, kind = SIZES.get(head, ("", dict if head < 0x90 else list if head < 0xA0 else str))
    if head in NUMBERS or form:
        form = ">" + NUMBERS.get(head, form)
        (size,), at = struct.unpack_from(form, data, at), at + struct.calcsize(form)
        if head in NUMBERS:
            return size, at
    elif head < 0xC0:
        size = head & (0x1F if kind is str else 0x0F)
    else:
        raise ValueError("another kind of value")
    if kind in (str, bytes):
        return data[at : at + size] if kind is bytes else data[at : at + size].decode(), at + size
    values = []
    for _ in range(size * (2 if kind is dict else 1)):
        value, at = _read(data, at)
        values.append(value)
    return values if kind is list else dict(zip(values[::2], values[1::2], strict=True)), at


def read_frame(data: bytes) -> tuple[int, int, int, int, bytes]:
    """Return version, kind, session, sequence and body of a datagram."""
    version, kind, session, sequence, body = unpackb(data)
    uint32(version, kind, session, sequence)
    if type(body) is not bytes:
        raise ValueError("no body")
    return version, kind, session, sequence, body


def uint32(*values: Any) -> tuple[int, ...]:
    """Return the values; raise ValueError if one of them is no integer of 32 bits."""
    if not all(type(value) is int and 0 <= value < 1 << 32 for value in values):
        raise ValueError("no uint32")
    return values


UNREADABLE = (ValueError, TypeError, LookupError, struct.error, RecursionError)
