"""Read positions from bytes, and write forces and keepalives, without msgpack: compiled for the bank.

`wire` and `messages` define the same bytes. What is not exactly the usual form, such as an integer that is longer than
it needs to be or a field that a later revision appends, is left to them.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.protocol.loss import REPORT_STEPS
from hapticnet.protocol.wire import Kind

Bytes = npt.NDArray[np.uint8]

ADDRESS_WORDS: Final = 7
"""Words of 32 bits of an address: 28 bytes, the size of a sockaddr_in6."""

SLOT_BYTES: Final = 1280
"""Space for a datagram that arrives: more than `READ_BYTES` of the runtime, so that reading on is harmless."""

ANSWER_BYTES: Final = 128
"""Space for an answer: frame 18 B, body 36 B, tag 16 B at most."""

NIL: Final = 0xC0
BIN8: Final = 0xC4
UINT8: Final = 0xCC
UINT16: Final = 0xCD
UINT32: Final = 0xCE
ARRAY: Final = 0x90
FRAME_ELEMENTS: Final = 5
POSITION_KIND: Final = int(Kind.POSITION)
SESSION_AT: Final = 4
"""Where the four bytes of the session number begin: numbers are at least 2¹⁶ (docs/protocol.md)."""

SEQUENCE_AT: Final = 8

NONE: Final = -1
"""Stands for a number that is missing, where Python has None."""


class Frame(NamedTuple):
    """The frame of a POSITION; version 0: not the usual form."""

    version: int
    session: int
    sequence: int
    head_end: int
    begins: int
    ends: int


class PositionBody(NamedTuple):
    """The body of a POSITION. `t_us` NONE: not the usual form; `newest` and `share` NONE: not there."""

    t_us: int
    newest: int
    payload_at: int
    payload_bytes: int
    share: float
    again: float


def signed(value: Any) -> int:
    """Return a byte as a number of 64 bits: a shift of a uint8 would overflow."""
    number: int = np.int64(value)  # type: ignore[assignment]
    return number


def read_uint32(data: Bytes, at: int) -> int:
    """Return the big-endian number of four bytes."""
    return signed(data[at]) << 24 | signed(data[at + 1]) << 16 | signed(data[at + 2]) << 8 | signed(data[at + 3])


def read_number(data: Bytes, at: int) -> tuple[int, int]:
    """Return an unsigned integer of up to 32 bits and where it ends; NONE if there is none."""
    first = signed(data[at])
    if first < 0x80:
        return first, at + 1
    if first == UINT8:
        return signed(data[at + 1]), at + 2
    if first == UINT16:
        return signed(data[at + 1]) << 8 | signed(data[at + 2]), at + 3
    if first == UINT32:
        return read_uint32(data, at + 1), at + 5
    return NONE, at


def read_frame(data: Bytes, length: int) -> Frame:
    """Return the frame of a datagram if it is a POSITION in the usual form."""
    if length <= SEQUENCE_AT or length > data.shape[0] - 16:
        return Frame(0, 0, 0, 0, 0, 0)
    if data[0] != ARRAY + FRAME_ELEMENTS or data[2] != POSITION_KIND or data[3] != UINT32:
        return Frame(0, 0, 0, 0, 0, 0)
    sequence, at = read_number(data, SEQUENCE_AT)
    begins = at + 2
    ends = begins + signed(data[at + 1])
    if sequence == NONE or data[at] != BIN8 or ends != length:
        return Frame(0, 0, 0, 0, 0, 0)
    return Frame(signed(data[1]), read_uint32(data, SESSION_AT), sequence, at, begins, ends)


def read_position(data: Bytes, begins: int, ends: int) -> PositionBody:
    """Return the body of a POSITION if it has the usual form."""
    fields = signed(data[begins]) - ARRAY
    t_us, at = read_number(data, begins + 1)
    if data[at] == NIL:
        newest, at = NONE, at + 1
    else:
        before = at
        newest, at = read_number(data, at)
        if at == before:
            return PositionBody(NONE, 0, 0, 0, 0.0, 0.0)
    payload_at, payload_bytes = at + 2, signed(data[at + 1])
    after = payload_at + payload_bytes
    if t_us == NONE or data[at] != BIN8:
        return PositionBody(NONE, 0, 0, 0, 0.0, 0.0)
    if fields == 3 and after == ends:
        return PositionBody(t_us, newest, payload_at, payload_bytes, float(NONE), 0.0)
    if fields == 5 and after + 2 == ends and data[after] <= REPORT_STEPS and data[after + 1] <= REPORT_STEPS:
        share, again = signed(data[after]) / REPORT_STEPS, signed(data[after + 1]) / REPORT_STEPS
        return PositionBody(t_us, newest, payload_at, payload_bytes, share, again)
    return PositionBody(NONE, 0, 0, 0, 0.0, 0.0)


def read_single(data: Bytes, at: int) -> float:
    """Return the big-endian float32 of four bytes."""
    bits = read_uint32(data, at)
    return float(np.int32(bits - ((bits >> 31) << 32)).view(np.float32))


def read_half(data: Bytes, at: int) -> float:
    """Return the big-endian float16 of two bytes (IEEE 754 binary16); infinity for infinities and NaN."""
    bits = signed(data[at]) << 8 | signed(data[at + 1])
    exponent, fraction = bits >> 10 & 31, bits & 1023
    if exponent == 31:
        return np.inf
    size = fraction * 2.0**-24 if exponent == 0 else (1024 + fraction) * 2.0 ** (exponent - 25.0)
    return -size if bits >> 15 else size


def write_number(out: Bytes, at: int, number: int) -> int:
    """Write an unsigned integer of up to 32 bits in its shortest form; return where it ends."""
    if number < 0x80:
        out[at] = number
        return at + 1
    if number < 0x100:
        out[at], out[at + 1] = UINT8, number
        return at + 2
    if number < 0x10000:
        out[at], out[at + 1], out[at + 2] = UINT16, number >> 8, number & 255
        return at + 3
    out[at] = UINT32
    for place in range(4):
        out[at + 1 + place] = number >> 8 * (3 - place) & 255
    return at + 5


def write_head(out: Bytes, version: int, kind: int, session: int, sequence: int) -> int:
    """Write a frame up to the body's head; return where that begins."""
    out[0], out[1], out[2] = ARRAY + FRAME_ELEMENTS, version, kind
    return write_number(out, write_number(out, 3, session), sequence)


def write_single(out: Bytes, at: int, x: float) -> int:
    """Write a float32, big-endian; return where it ends."""
    bits = signed(np.float32(x).view(np.int32))
    for place in range(4):
        out[at + place] = bits >> 8 * (3 - place) & 255
    return at + 4


def write_double(out: Bytes, at: int, x: float) -> int:
    """Write a float64, big-endian; return where it ends."""
    bits = signed(np.float64(x).view(np.int64))
    for place in range(8):
        out[at + place] = bits >> 8 * (7 - place) & 255
    return at + 8


def write_short(out: Bytes, at: int, number: int) -> int:
    """Write an int16, big-endian; return where it ends."""
    out[at], out[at + 1] = number >> 8 & 255, number & 255
    return at + 2


def same_address(ours: Any, theirs: Any) -> bool:
    """Tell whether two addresses are the same."""
    for word in range(ADDRESS_WORDS):  # noqa: SIM110 - numba compiles no generator expressions
        if ours[word] != theirs[word]:
            return False
    return True


def set_address(to: Any, address: Any) -> None:
    """Copy an address."""
    for word in range(ADDRESS_WORDS):
        to[word] = address[word]
