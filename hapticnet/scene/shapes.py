"""How a scene looks: shapes for a page to draw. No force is computed from them.

Coordinates are those of positions [m]; a scene of fewer than three axes chooses the others. On the picture the first
axis points down, the second to the right and the third away, unless a shape ``view`` says otherwise.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

from hapticnet.errors import PeerError, SampleError
from hapticnet.samples import Vector

KINDS: Final = ("plane", "sphere", "capsule", "box", "view")
MOST_SHAPES: Final = 255  # of a scene; further ones are not drawn
FARTHEST_M: Final = 1e6
EVERY_US: Final = 33_333  # how often [µs] what moved is sent
AGAIN_US: Final = 1_000_000  # after this time [µs] a shape is sent again, because a datagram may be lost
AT_ONCE: Final = 22  # shapes that fit into a datagram
_NEVER_US: Final = -1 << 62
_NUMBERS: Final = struct.Struct(">12f")
_SHAPE_BYTES: Final = 2 + _NUMBERS.size


class Shape(NamedTuple):
    """A shape, and where it is now. Missing components of its vectors are zero.

    Attributes
    ----------
    kind
        ``plane`` through `at_m`, solid in the direction `along`; ``sphere`` of radius `size_m`; ``capsule`` of radius
        and half length `size_m`, which lies `along`; ``box`` of three half lengths `size_m`, the first `along`, the
        second `across`; or ``view``, which is not drawn: up is `along`, right is `across`, away is `size_m`.
    at_m
        Its centre [m].
    size_m
        Up to three numbers [m].
    along, across
        Unit vectors at right angles.
    """

    kind: str
    at_m: Vector = ()
    size_m: Vector = ()
    along: Vector = (1.0,)
    across: Vector = (0.0, 1.0)


Shapes: TypeAlias = Callable[[], Sequence[Shape]]


def pack_shape(shape: Sequence[object]) -> bytes:
    """Return a shape as bytes, rounded to what an eye sees; SampleError if it is not one."""
    kind, *vectors = Shape(*shape)  # type: ignore[arg-type]
    if kind not in KINDS:
        raise SampleError(f"a shape is {kind!r}; it must be one of: {', '.join(KINDS)}")
    numbers: list[float] = []
    for name, vector, digits in zip(Shape._fields[1:], vectors, (4, 4, 3, 3), strict=True):
        given = [float(each) for each in vector]
        if len(given) > 3 or not all(abs(each) <= FARTHEST_M for each in given):  # NaN compares false
            raise SampleError(f"{name} of a {kind} is {given}; it must be at most three finite numbers")
        numbers += [round(each, digits) + 0.0 for each in given] + [0.0] * (3 - len(given))
    return bytes([KINDS.index(kind)]) + _NUMBERS.pack(*numbers)


def unpack_shapes(data: bytes) -> tuple[int, dict[int, Shape]]:
    """Return the number of shapes of a scene, and those in `data` by their place; PeerError if it is malformed."""
    count, rest = data[0] if data else 0, len(data) - 1
    if count == 0 or rest % _SHAPE_BYTES:
        raise PeerError(f"{len(data)} bytes of {count} shapes are not what the protocol allows")
    found: dict[int, Shape] = {}
    for start in range(1, len(data), _SHAPE_BYTES):
        place, kind = data[start], data[start + 1]
        numbers = tuple([round(each, 4) for each in _NUMBERS.unpack_from(data, start + 2)])
        if place >= count or kind >= len(KINDS) or not all(abs(each) <= FARTHEST_M for each in numbers):
            raise PeerError(f"shape {place} of {count} and kind {kind} is not what the protocol allows")
        found[place] = Shape(KINDS[kind], numbers[:3], numbers[3:6], numbers[6:9], numbers[9:])
    return count, found


class ShapeFeed:
    """What to send of a scene's shapes: those that moved, and each again after a second."""

    def __init__(self, shapes: Shapes) -> None:
        self._shapes = shapes
        self._due_us = 0
        self._seen: list[tuple[Shape | None, bytes]] = []  # so that what never changes is packed once
        self._sent: dict[int, tuple[int, bytes]] = {}  # time [µs] and content

    def due(self, now_us: int) -> bytes | None:
        """Return what to send now, or None; raise what the scene raises, and SampleError if its shapes are invalid."""
        if self._due_us - EVERY_US <= now_us < self._due_us:
            return None
        self._due_us = now_us + EVERY_US
        shapes = self._shapes()[:MOST_SHAPES]
        old_ones = self._seen + [(None, b"")] * len(shapes)
        self._seen = [
            old if old[0] is shape else (shape, pack_shape(shape)) for shape, old in zip(shapes, old_ones, strict=False)
        ]
        waiting: list[tuple[int, int]] = []
        for place, (_, content) in enumerate(self._seen):
            at_us, sent = self._sent.get(place, (_NEVER_US, b""))
            if content != sent or not 0 <= now_us - at_us < AGAIN_US:
                waiting.append((at_us, place))
        chosen = [place for _, place in sorted(waiting)[:AT_ONCE]]  # those that have waited longest
        self._sent.update({place: (now_us, self._seen[place][1]) for place in chosen})
        count = bytes([len(self._seen)])
        return count + b"".join(bytes([place]) + self._seen[place][1] for place in chosen) if chosen else None
