"""Datagrams of programs in any language: one vector, in msgpack or JSON (``--operator udp:…``, ``--scene udp:…``).

A datagram is a msgpack array ``[x, …]``, a msgpack map such as ``{"position_m": [x, …]}``, or the same as JSON.
docs/use/embedding.md describes them for programs in any language.
"""

import json
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import msgpack

from hapticnet.checks import meant
from hapticnet.errors import PeerError, SettingsError
from hapticnet.samples import Vector

MOST_BYTES: Final = 512  # largest datagram that is read; three coordinates take 50 to 100 bytes
KIND: Final = "udp"  # what the text of such a program begins with


class Form(NamedTuple):
    """The form of a datagram."""

    text: str
    is_json: bool
    is_map: bool


ARRAY: Final = Form("msgpack array", False, False)
MAP: Final = Form("msgpack map", False, True)
JSON_ARRAY: Final = Form("JSON array", True, False)
JSON_OBJECT: Final = Form("JSON object", True, True)


class Quantity(NamedTuple):
    """What a datagram holds: its key in a map, what one of its values is called, and the largest plausible value."""

    key: str
    noun: str
    largest: float
    unit: str
    units: str  # the unit in words
    example: float


POSITION: Final = Quantity("position_m", "coordinate", 10.0, "m", "metres", 0.01)  # larger ones may be millimetres
FORCE: Final = Quantity("force_n", "component", 1e6, "N", "newtons", 1.5)


def read_vector(data: bytes, of: Quantity, axes: int) -> tuple[Form, Vector, dict[Any, Any]]:
    """Return form, vector and map of a datagram (of an array: an empty map).

    Raise PeerError if it is not a vector of this quantity with so many axes.
    """
    if len(data) > MOST_BYTES:
        raise PeerError(f"a datagram of {len(data)} bytes; a {of.key.partition('_')[0]} has at most {MOST_BYTES}")
    is_json = data.startswith((b"{", b"["))
    try:
        found: Any = json.loads(data) if is_json else msgpack.unpackb(data)
    except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise PeerError(f"neither msgpack nor JSON: {' '.join(str(error).split())[:80] or 'incomplete'}") from error
    if type(found) is dict:
        values = found.get(of.key)
        form = JSON_OBJECT if is_json else MAP
        if type(values) is float or type(values) is int:
            values = [values]
    else:
        found, values = {}, found
        form = JSON_ARRAY if is_json else ARRAY
    example = str([of.example, 0.0, 0.0][:axes])
    if type(values) is not list or not all(type(each) in (float, int) for each in values):
        expected = f"{of.key} must be" if form.is_map else "expected"
        raise PeerError(f"{expected} a list of {axes} numbers, such as {example}")
    for each in values:
        # Written so that NaN, which compares false with everything, is refused too.
        if not -of.largest <= each <= of.largest:
            raise PeerError(
                f"{of.noun} {str(each)[:30]} is not within ±{of.largest:g} {of.unit}; {of.noun}s are {of.units}"
            )
    if len(values) != axes:
        raise PeerError(f"{len(values)} {of.noun}s; expected {axes}, such as {example}")
    return form, tuple(map(float, values)), found


def write(form: Form, answer: object) -> bytes:
    """Return a list or a map as a datagram."""
    if form.is_json:
        return json.dumps(answer).encode()
    packed: bytes = msgpack.packb(answer)
    return packed


def is_program(text: str) -> bool:
    """Return whether the text of an operator or a scene names a program that is reached by datagrams."""
    return text.partition(":")[0] == KIND


def parse_program(text: str, role: str, keys: Sequence[str]) -> tuple[str, dict[str, str]]:
    """Return address and values of ``udp:[HOST:]PORT[,KEY=VALUE…]``; the host is this one unless named.

    Raise SettingsError if a key is not one of `keys`, or not given as KEY=VALUE; `role` begins the message.
    """
    place, *parts = text.partition(":")[2].split(",")
    values: dict[str, str] = {}
    for part in parts:
        key, equals, value = (each.strip() for each in part.partition("="))
        if key not in keys:
            raise SettingsError(f"{role} {text!r} has no {key!r}{meant(key, keys)}; there are: {', '.join(keys)}")
        if not equals or not value or key in values:
            raise SettingsError(f"{role} {text!r}: {part!r} must be KEY=VALUE, each key once, as in axes=3")
        values[key] = value
    return place if ":" in place else f"127.0.0.1:{place}", values
