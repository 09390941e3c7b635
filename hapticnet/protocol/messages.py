"""The messages: each is a tuple whose fields, in order, are the body of its datagram."""

import enum
import math
from typing import Any, Final, NamedTuple

from hapticnet.errors import PeerError
from hapticnet.protocol.wire import Kind, is_uint32, pack, pack_body, unpack_body

HELLO_BYTES: Final = 400
"""Smallest HELLO datagram [B]. The padding makes every answer to a stranger smaller than the question, so that a slave
cannot be used to amplify a flood of forged HELLOs."""

NAME_BYTES: Final = 64
REASON_BYTES: Final = 200


class Code(enum.IntEnum):
    """Why a session was refused or closed, for a program to act on. A number that is not listed reads as `OTHER`."""

    OTHER = 0
    VERSION = 1
    CODEC = 2
    PARAMETER = 3
    AXES = 4
    FULL = 5
    FAILED = 6

    @classmethod
    def _missing_(cls, value: object) -> "Code":  # noqa: ARG003 - the signature is the enum module's
        return cls.OTHER


class Hello(NamedTuple):
    """Master to slave: the session it asks for. The JND belongs to the person at the master."""

    nonce: int
    codec: str
    parameters: dict[str, float]
    weber_fraction: float
    floor_n: float
    multiplier: float
    rate_hz: float
    axes: int
    name: str


class Welcome(NamedTuple):
    """Slave to master: the session it grants; its number is in the frame."""

    nonce: int
    rate_hz: float
    keepalive_us: int
    scene: str


class Refuse(NamedTuple):
    """Slave to master: no session, and why."""

    nonce: int
    reason: str
    code: Code = Code.OTHER


class Position(NamedTuple):
    """Master to slave: where the tool tip is, and the sequence of the newest FORCE applied (None: none yet)."""

    t_us: int
    newest_force: int | None
    payload: bytes


class Force(NamedTuple):
    """Slave to master: the whole stimulus that answers the position of time `t_us`."""

    t_us: int
    payload: bytes


class Keepalive(NamedTuple):
    """Slave to master: position `t_us` was heard, and FORCE `newest_force` still holds."""

    t_us: int
    newest_force: int | None


class Close(NamedTuple):
    """Either way: the session ends. The slave answers a CLOSE with a CLOSE."""

    reason: str
    code: Code = Code.OTHER


def pack_hello(hello: Hello, sequence: int) -> bytes:
    """Return a HELLO datagram, padded to `HELLO_BYTES`."""
    bare = pack(Kind.HELLO, 0, sequence, pack_body((*hello, b"")))
    padding = bytes(max(0, HELLO_BYTES - len(bare)))
    return pack(Kind.HELLO, 0, sequence, pack_body((*hello, padding)))


def unpack_hello(body: bytes) -> Hello:
    """Return the HELLO in a body; raise PeerError if it is invalid."""
    fields = unpack_body(body, 10)
    nonce, codec, parameters, weber_fraction, floor_n, multiplier, rate_hz, axes, name, padding = fields
    _require(is_uint32(nonce), "nonce", nonce)
    _require(_is_text(codec, NAME_BYTES), "codec", codec)
    _require(type(parameters) is dict, "parameters", parameters)
    for key, value in parameters.items():
        _require(_is_text(key, NAME_BYTES) and _is_number(value), "parameter", key)
    _require(
        _is_number(weber_fraction) and _is_number(floor_n) and _is_number(multiplier),
        "JND",
        (weber_fraction, floor_n, multiplier),
    )
    _require(_is_number(rate_hz) and 0.0 < rate_hz <= 1e6, "rate", rate_hz)
    _require(type(axes) is int and 1 <= axes <= 3, "axes", axes)
    _require(_is_text(name, NAME_BYTES), "name", name)
    _require(type(padding) is bytes, "padding", padding)
    numbers = {key: float(value) for key, value in parameters.items()}
    jnd = float(weber_fraction), float(floor_n), float(multiplier)
    return Hello(nonce, codec, numbers, *jnd, float(rate_hz), axes, name)


def unpack_welcome(body: bytes) -> Welcome:
    """Return the WELCOME in a body; raise PeerError if it is invalid."""
    nonce, rate_hz, keepalive_us, scene = unpack_body(body, 4)
    _require(is_uint32(nonce), "nonce", nonce)
    _require(_is_number(rate_hz) and 0.0 < rate_hz <= 1e6, "rate", rate_hz)
    _require(is_uint32(keepalive_us), "keepalive interval", keepalive_us)
    _require(_is_text(scene, NAME_BYTES), "scene", scene)
    return Welcome(nonce, float(rate_hz), keepalive_us, scene)


def unpack_refuse(body: bytes) -> Refuse:
    """Return the REFUSE in a body; raise PeerError if it is invalid."""
    nonce, reason, code = unpack_body(body, 3)
    _require(is_uint32(nonce), "nonce", nonce)
    _require(_is_text(reason, REASON_BYTES), "reason", reason)
    _require(is_uint32(code), "code", code)
    return Refuse(nonce, reason, Code(code))


def unpack_position(body: bytes) -> Position:
    """Return the POSITION in a body; raise PeerError if it is invalid."""
    t_us, newest_force, payload = unpack_body(body, 3)
    if not (is_uint32(t_us) and (newest_force is None or is_uint32(newest_force)) and type(payload) is bytes):
        raise PeerError("POSITION of the wrong types")
    return Position(t_us, newest_force, payload)


def unpack_force(body: bytes) -> Force:
    """Return the FORCE in a body; raise PeerError if it is invalid."""
    t_us, payload = unpack_body(body, 2)
    if not (is_uint32(t_us) and type(payload) is bytes):
        raise PeerError("FORCE of the wrong types")
    return Force(t_us, payload)


def unpack_keepalive(body: bytes) -> Keepalive:
    """Return the KEEPALIVE in a body; raise PeerError if it is invalid."""
    t_us, newest_force = unpack_body(body, 2)
    if not (is_uint32(t_us) and (newest_force is None or is_uint32(newest_force))):
        raise PeerError("KEEPALIVE of the wrong types")
    return Keepalive(t_us, newest_force)


def unpack_close(body: bytes) -> Close:
    """Return the CLOSE in a body; raise PeerError if it is invalid."""
    reason, code = unpack_body(body, 2)
    _require(_is_text(reason, REASON_BYTES), "reason", reason)
    _require(is_uint32(code), "code", code)
    return Close(reason, Code(code))


def clipped(text: str, limit: int) -> str:
    """Return `text` cut to at most `limit` bytes of UTF-8, without control characters a terminal would obey."""
    printable = "".join(character if character.isprintable() else "?" for character in text)
    return printable.encode()[:limit].decode(errors="ignore")


def _is_text(value: object, limit: int) -> bool:
    return type(value) is str and value.isprintable() and len(value.encode()) <= limit


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]


def _require(good: bool, what: str, value: Any) -> None:
    if not good:
        raise PeerError(f"{what} {value!r} is not what the protocol allows")
