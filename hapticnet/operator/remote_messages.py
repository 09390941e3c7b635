"""Datagrams between a program that moves the tool and the master: positions in, forces out.

A position is a msgpack array ``[x, …]``, a msgpack map ``{"position_m": [x, …]}`` or the same as JSON. The answer has
the form of the question: an array ``[f, …]``, or a map with ``force_n``, ``position_m`` and ``t_us``.
docs/embedding.md describes them for programs in any language.
"""

import json
from enum import Enum
from typing import Any, Final

import msgpack

from hapticnet.errors import PeerError, SampleError
from hapticnet.samples import Vector, checked_vector

MOST_BYTES: Final = 512
"""Largest datagram that is read; three positions take 50 to 100 bytes."""

FARTHEST_M: Final = 10.0
"""Largest plausible coordinate [m]; larger ones are probably millimetres."""

POSITION: Final = "position_m"


class Form(Enum):
    """How a datagram is written."""

    ARRAY = "msgpack array"
    MAP = "msgpack map"
    JSON_ARRAY = "JSON array"
    JSON_MAP = "JSON object"


def read_position(data: bytes, axes: int) -> tuple[Form, Vector]:
    """Return form and position [m] of a datagram.

    Raises
    ------
    PeerError
        If it is not a position with `axes` coordinates; the message says why.
    """
    if len(data) > MOST_BYTES:
        raise PeerError(f"a datagram of {len(data)} bytes; a position has at most {MOST_BYTES}")
    is_json = data[:1] in (b"{", b"[")
    try:
        found: Any = json.loads(data) if is_json else msgpack.unpackb(data)
    except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise PeerError(f"neither msgpack nor JSON: {' '.join(str(error).split())[:80] or 'incomplete'}") from error
    as_map = isinstance(found, dict)
    values = found.get(POSITION) if as_map else found
    if isinstance(values, (int, float)) and not isinstance(values, bool) and as_map:
        values = [values]
    if not isinstance(values, list) or not all(type(each) in (int, float) for each in values):
        expected = f"{POSITION} must be" if as_map else "expected"
        raise PeerError(f"{expected} a list of {axes} numbers, such as {_example(axes)}")
    if len(values) != axes:
        raise PeerError(f"{len(values)} coordinates; expected {axes}, such as {_example(axes)}")
    try:
        position_m = checked_vector(values, "position")
    except (SampleError, OverflowError) as error:
        raise PeerError(f"not a finite position: {str(values)[:60]}") from error
    if not all(-FARTHEST_M <= x <= FARTHEST_M for x in position_m):
        raise PeerError(f"position {list(position_m)} m is beyond {FARTHEST_M:g} m; positions are metres")
    if is_json:
        return (Form.JSON_MAP if as_map else Form.JSON_ARRAY), position_m
    return (Form.MAP if as_map else Form.ARRAY), position_m


def write_force(form: Form, force_n: Vector, position_m: Vector, t_us: int) -> bytes:
    """Return the answer to a position: the force [N] on all axes; a map also tells where the tool is [m], and when."""
    is_map = form in (Form.MAP, Form.JSON_MAP)
    answer: Any = {"force_n": force_n, POSITION: position_m, "t_us": t_us} if is_map else force_n
    if form in (Form.JSON_MAP, Form.JSON_ARRAY):
        return json.dumps(answer).encode()
    packed: bytes = msgpack.packb(answer)
    return packed


def _example(axes: int) -> str:
    return str([0.01, 0.0, 0.0][:axes])
