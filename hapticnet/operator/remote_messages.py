"""Datagrams between a program that moves the tool and the master: positions in, forces out.

A position is a msgpack array ``[x, …]``, a msgpack map ``{"position_m": [x, …]}`` or the same as JSON. The answer has
the form of the question: an array ``[f, …]``, or a map with ``force_n``, ``position_m`` and ``t_us``.
docs/use/embedding.md describes them for programs in any language.
"""

import json
from typing import Any, Final, NamedTuple

import msgpack

from hapticnet.errors import PeerError
from hapticnet.samples import Vector

MOST_BYTES: Final = 512
"""Largest datagram that is read; three positions take 50 to 100 bytes."""

FARTHEST_M: Final = 10.0
"""Largest plausible coordinate [m]; larger ones are probably millimetres."""

POSITION: Final = "position_m"


class Form(NamedTuple):
    """How a datagram is written."""

    text: str
    is_json: bool
    is_map: bool


ARRAY: Final = Form("msgpack array", False, False)
MAP: Final = Form("msgpack map", False, True)
JSON_ARRAY: Final = Form("JSON array", True, False)
JSON_OBJECT: Final = Form("JSON object", True, True)


def read_position(data: bytes, axes: int) -> tuple[Form, Vector]:
    """Return form and position [m] of a datagram.

    Raises
    ------
    PeerError
        If it is not a position with `axes` coordinates; the message says why.
    """
    if len(data) > MOST_BYTES:
        raise PeerError(f"a datagram of {len(data)} bytes; a position has at most {MOST_BYTES}")
    is_json = data.startswith((b"{", b"["))
    try:
        found: Any = json.loads(data) if is_json else msgpack.unpackb(data)
    except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise PeerError(f"neither msgpack nor JSON: {' '.join(str(error).split())[:80] or 'incomplete'}") from error
    if type(found) is dict:
        values = found.get(POSITION)
        form = JSON_OBJECT if is_json else MAP
        if type(values) is float or type(values) is int:
            values = [values]
    else:
        values = found
        form = JSON_ARRAY if is_json else ARRAY
    if type(values) is not list:
        raise _not_numbers(form, axes)
    for each in values:
        if type(each) is not float and type(each) is not int:
            raise _not_numbers(form, axes)
        # Written so that NaN, which compares false with everything, is refused too.
        if not -FARTHEST_M <= each <= FARTHEST_M:
            raise PeerError(f"coordinate {str(each)[:30]} is not within ±{FARTHEST_M:g} m; coordinates are metres")
    if len(values) != axes:
        raise PeerError(f"{len(values)} coordinates; expected {axes}, such as {_example(axes)}")
    return form, tuple(map(float, values))


def write_force(form: Form, force_n: Vector, position_m: Vector, t_us: int) -> bytes:
    """Return the answer to a position: the force [N] on all axes; a map also tells where the tool is [m], and when."""
    answer: Any = {"force_n": force_n, POSITION: position_m, "t_us": t_us} if form.is_map else force_n
    if form.is_json:
        return json.dumps(answer).encode()
    packed: bytes = msgpack.packb(answer)
    return packed


def _not_numbers(form: Form, axes: int) -> PeerError:
    expected = f"{POSITION} must be" if form.is_map else "expected"
    return PeerError(f"{expected} a list of {axes} numbers, such as {_example(axes)}")


def _example(axes: int) -> str:
    return str([0.01, 0.0, 0.0][:axes])
