"""What pages say, read. `messages` is the specification."""

import json
import math
import struct
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from hapticnet.errors import PeerError
from hapticnet.samples import LARGEST_COMPONENT

MOST_MISTAKES: Final = 20
LARGEST_MESSAGE: Final = 4096  # limit of a message from a page [B]
HAND: Final = 1
_HAND: Final = struct.Struct("<BBHfd")
HAND_BYTES: Final = _HAND.size


class MistakeError(PeerError):
    """A message from a page is not of this specification."""


@dataclass(frozen=True, slots=True)
class Hand:
    """A position of the hand from a page."""

    position_m: float
    time_ms: float


@dataclass(frozen=True, slots=True)
class Take:
    """Take the hand."""


@dataclass(frozen=True, slots=True)
class Release:
    """Give the hand back."""


@dataclass(frozen=True, slots=True)
class LetGo:
    """Withdraw the needle and free the hand, whoever has it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """Settings to change while it runs; None leaves one as it is."""

    multiplier: float | None = None
    codec: str | None = None
    delay_ms: float | None = None
    loss_percent: float | None = None


@dataclass(frozen=True, slots=True)
class Key:
    """Press a key of the task with this number."""

    number: int
    key: str


@dataclass(frozen=True, slots=True)
class Noise:
    """The level of the masking noise, as a share of full scale; 0 if it is off."""

    level: float


PageMessage: TypeAlias = Hand | Take | Release | LetGo | Change | Key | Noise

LIMITS: Final[dict[str, tuple[float, float]]] = {
    "multiplier": (0.0, 8.0),
    "delay_ms": (0.0, 250.0),
    "loss_percent": (0.0, 50.0),
}
"""Ranges of the settings that a page may change.

The delay applies in each direction, so that the largest one stays well below the largest age of a force, 1 s.
"""

_ORDERS: Final[dict[str, PageMessage]] = {"take": Take(), "release": Release(), "let_go": LetGo()}


def parse_binary(data: bytes) -> Hand:
    """Return the HAND message in `data`; raise MistakeError if it is none, or its numbers are not finite."""
    if len(data) != HAND_BYTES or data[0] != HAND:
        kind = data[0] if data else "none"
        raise MistakeError(
            f"binary message of {len(data)} bytes and kind {kind}; expected {HAND_BYTES} and kind {HAND}"
        )
    _, _, _, position_m, time_ms = _HAND.unpack(data)
    if not abs(position_m) <= LARGEST_COMPONENT or not math.isfinite(time_ms):
        raise MistakeError(f"the hand is at {position_m} m at {time_ms} ms; both must be finite")
    return Hand(position_m, time_ms)


def parse_text(data: str) -> PageMessage:
    """Return the JSON message in `data`.

    Raise MistakeError if it is not JSON, not of a known type, or a value is out of range.
    """
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise MistakeError(f"{data[:40]!r} is not JSON") from None
    if not isinstance(content, dict) or not isinstance(kind := content.pop("type", None), str):
        raise MistakeError("a message must be an object with a 'type'")
    if kind == "set":
        return _change(content)
    if kind == "key":
        return _key(content)
    if kind == "noise":
        return _noise(content)
    if kind not in _ORDERS:
        raise MistakeError(f"unknown message {kind[:40]!r}; there are: {', '.join(_ORDERS)}, set, key, noise")
    if content:
        raise MistakeError(f"message {kind!r} has no key {next(iter(content))[:40]!r}")
    return _ORDERS[kind]


def _change(content: dict[str, Any]) -> Change:
    if not content:
        raise MistakeError(f"message 'set' changes nothing; it takes: {', '.join(Change.__dataclass_fields__)}")
    for key, value in content.items():
        if key == "codec":
            if not isinstance(value, str):
                raise MistakeError("codec must be a name")
        elif key not in LIMITS:
            raise MistakeError(f"cannot set {key[:40]!r}; only: {', '.join(Change.__dataclass_fields__)}")
        elif isinstance(value, bool) or not isinstance(value, (int, float)):
            raise MistakeError(f"{key} must be a number")
        elif not LIMITS[key][0] <= value <= LIMITS[key][1]:
            low, high = LIMITS[key]
            raise MistakeError(f"{key} is {str(value)[:20]}; it must be between {low:g} and {high:g}")
    return Change(**content)


def _key(content: dict[str, Any]) -> Key:
    number, key = content.get("number"), content.get("key")
    if len(content) != 2 or type(number) is not int or not isinstance(key, str):
        raise MistakeError("message 'key' takes the number of a task and a key, and nothing else")
    return Key(number, key)


def _noise(content: dict[str, Any]) -> Noise:
    level = content.get("level")
    if len(content) != 1 or isinstance(level, bool) or not isinstance(level, (int, float)) or not 0.0 <= level <= 1.0:
        raise MistakeError("message 'noise' takes a level between 0 and 1, and nothing else")
    return Noise(float(level))
