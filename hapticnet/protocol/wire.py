"""One datagram: a msgpack array [version, kind, session, sequence, body].

The body is a byte string: the msgpack array of the message's fields, or its ciphertext in a sealed session. The first
four elements stay readable and are authenticated by a seal. `sequence` never repeats within a session and direction, so
that it can be the nonce.

There are two versions. Sessions of version 1 are open: anyone on the path can read and forge them. Sessions of version
2 are sealed (`protocol.seal`).
"""

import enum
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeVar

import msgpack

from hapticnet.errors import PeerError
from hapticnet.samples import new_tuple

MODULUS: Final = 1 << 32
HALF: Final = 1 << 31
MOST: Final = MODULUS - 1


def wrap(number: int) -> int:
    """Return a number as on the wire, 0 to 2³² - 1."""
    return number & MOST


def distance(newer: int, older: int) -> int:
    """Return how far `newer` is ahead of `older`, from -2³¹ to 2³¹ - 1."""
    return ((newer - older + HALF) & MOST) - HALF


def unwrap(number: int, near: int) -> int:
    """Return the unwrapped number closest to the unwrapped number `near`."""
    return near + ((number - near + HALF) & MOST) - HALF


E = TypeVar("E", bound=enum.Enum)


def plain_members(enumeration: type[E]) -> type[E]:
    """Store the members as plain attributes, because every datagram needs them.

    Before Python 3.12 a member is found by a descriptor written in Python, which costs more than most functions here.
    """
    for member in enumeration:
        type.__setattr__(enumeration, member.name, member)
    return enumeration


OPEN: Final = 1  # version of sessions without keys
SEALED: Final = 2  # version of sessions whose messages are encrypted and authenticated
VERSIONS: Final = (OPEN, SEALED)

MAX_DATAGRAM_BYTES: Final = 1200
"""Larger datagrams are dropped. Fits every IPv6 path without fragments (RFC 8200 §5: 1280 B links)."""

UDP_IPV4_HEADER_BYTES: Final = 28  # IPv4 header without options (RFC 791, 20 B) and UDP header (RFC 768, 8 B)
MAX_ELEMENTS: Final = 32  # most elements of an array or map


@plain_members
class Kind(enum.IntEnum):
    """Kind of a datagram."""

    HELLO = 1
    WELCOME = 2
    REFUSE = 3
    POSITION = 4
    FORCE = 5
    KEEPALIVE = 6
    CLOSE = 7
    RESET = 8
    COOKIE = 9
    NOTICE = 10
    VIBRATION = 11


_pack = msgpack.Packer().pack  # one packer for all datagrams: a new one for each would double the cost
pack_body: Final[Callable[[tuple[Any, ...]], bytes]] = _pack
"""Return the body of a message: its fields as a msgpack array."""

KINDS: Final = {int(kind): kind for kind in Kind}

ANY_VERSION: Final = (Kind.HELLO, Kind.REFUSE)
"""Kinds whose frame and first fields are the same in every version, so that versions can recognise each other."""


class Datagram(NamedTuple):
    """A datagram with a valid frame; its body has not been read yet."""

    version: int
    kind: Kind
    session: int
    sequence: int
    body: bytes


def pack(kind: int, session: int, sequence: int, body: bytes, version: int = OPEN) -> bytes:
    """Return a datagram."""
    datagram: bytes = _pack((version, kind, session, sequence, body))
    return datagram


def unpack(data: bytes) -> Datagram:
    """Return the datagram in `data`.

    Raise PeerError if it is oversized, not msgpack, not an array of the right shape, or of a version not in `VERSIONS`
    and not one of `ANY_VERSION`.
    """
    if len(data) > MAX_DATAGRAM_BYTES:
        raise PeerError(f"datagram of {len(data)} bytes; at most {MAX_DATAGRAM_BYTES} are read")
    try:  # `_decode`, inlined
        fields = msgpack.unpackb(
            data, use_list=False, max_array_len=MAX_ELEMENTS, max_map_len=MAX_ELEMENTS, max_ext_len=0
        )
    except (ValueError, TypeError) as error:
        raise PeerError(f"not msgpack: {error!r}") from error
    if type(fields) is not tuple:
        raise PeerError(f"a msgpack {type(fields).__name__} instead of an array")
    if len(fields) != 5:
        raise PeerError(f"datagram of {len(fields)} elements instead of 5")
    version, number, session, sequence, body = fields
    # Written out instead of calling `is_uint32`: every datagram passes here, and calls would double the cost.
    if not (
        type(session) is type(sequence) is type(number) is int
        and type(body) is bytes
        and 0 <= session < MODULUS
        and 0 <= sequence < MODULUS
    ):
        raise PeerError("datagram frame of the wrong types")
    kind = KINDS.get(number)
    if kind is None:
        raise PeerError(f"datagram of unknown kind {number}")
    if type(version) is not int or (version not in VERSIONS and (version < 0 or kind not in ANY_VERSION)):
        raise PeerError(f"datagram of protocol version {version!r}; the versions are {OPEN} and {SEALED}")
    return new_tuple(Datagram, (version, kind, session, sequence, body))


def unpack_body(body: bytes, length: int, *, optional: int = 0) -> tuple[Any, ...]:
    """Return `length` fields of a body and up to `optional` more, ignoring the rest; PeerError if it is invalid."""
    fields = _decode(body)
    if length <= len(fields) <= length + optional:
        return fields
    if len(fields) < length:
        raise PeerError(f"body of {len(fields)} fields; expected at least {length}")
    return fields[: length + optional]


def unpack_nonce(body: bytes) -> int:
    """Return the nonce of a HELLO of any version: its first field."""
    fields = _decode(body)
    if not fields or not is_uint32(fields[0]):
        raise PeerError("HELLO without a nonce")
    nonce: int = fields[0]
    return nonce


def is_uint32(value: object) -> bool:
    """Return whether a decoded value is an unsigned 32-bit integer (and not a boolean)."""
    return type(value) is int and 0 <= value < MODULUS


def _decode(data: bytes) -> tuple[Any, ...]:
    try:
        fields = msgpack.unpackb(
            data, use_list=False, max_array_len=MAX_ELEMENTS, max_map_len=MAX_ELEMENTS, max_ext_len=0
        )
    # msgpack raises a ValueError of some kind for malformed data, and TypeError for keys that cannot be hashed.
    except (ValueError, TypeError) as error:
        raise PeerError(f"not msgpack: {error!r}") from error
    if type(fields) is not tuple:
        raise PeerError(f"a msgpack {type(fields).__name__} instead of an array")
    return fields
