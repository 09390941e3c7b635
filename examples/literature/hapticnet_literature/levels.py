"""Stimuli as indices of levels: int16 an axis, negative below zero. The levels are the same on both sides of zero."""

from collections.abc import Sequence
from typing import Final

from hapticnet.codec.values import COUNT, COUNT_BYTES, ValueForm
from hapticnet.errors import PeerError
from hapticnet.samples import Vector

LEVEL: Final = COUNT_BYTES
"""The form of a message that consists of levels, and its bytes an axis."""


def index_of(edges: Sequence[float], size: float) -> int:
    """Return the index of the first cell that ends at or above a magnitude, or the number of cells if none does."""
    first, last = 0, len(edges)
    while first < last:
        middle = (first + last) // 2
        if edges[middle] < size:
            first = middle + 1
        else:
            last = middle
    return first


def level_of(levels: Sequence[float], edges: Sequence[float], x: float) -> float:
    """Return the level in whose cell a number is."""
    index = index_of(edges, abs(x))
    return -levels[index] if x < 0.0 and index > 0 else levels[index]


def level_at(levels: Sequence[float], edges: Sequence[float], x: Vector) -> Vector:
    """Return the level of every component."""
    if len(x) == 1:
        return (level_of(levels, edges, x[0]),)
    if len(x) == 2:
        return level_of(levels, edges, x[0]), level_of(levels, edges, x[1])
    return level_of(levels, edges, x[0]), level_of(levels, edges, x[1]), level_of(levels, edges, x[2])


class LevelForm:
    """Messages ``(form, value)`` as bytes, where the value consists of levels or is a plain one. Satisfies `Form`."""

    __slots__ = ("_edges", "_indices", "_levels", "_values")

    def __init__(self, axes: int, levels: Sequence[float], edges: Sequence[float]) -> None:
        self._values = ValueForm(axes)
        self._levels, self._edges = levels, edges
        self._indices = COUNT[axes]

    def pack(self, message: tuple[int, Vector]) -> bytes:
        """Return the payload of a message."""
        form, value = message
        if form != LEVEL:
            return self._values.pack(message)
        indices = [index_of(self._edges, abs(level)) for level in value]
        return self._indices.pack(*[-i if x < 0.0 else i for i, x in zip(indices, value, strict=True)])

    def unpack(self, payload: bytes, receiver: object = None) -> tuple[int, Vector]:
        """Return the message in a payload; PeerError if there is no such level, form or value."""
        if len(payload) != self._indices.size:
            return self._values.unpack(payload, receiver)
        signed = self._indices.unpack(payload)
        if max(map(abs, signed)) >= len(self._levels):
            raise PeerError(f"payload holds levels {signed}; there are {len(self._levels) - 1} on either side of zero")
        return LEVEL, tuple([-self._levels[-i] if i < 0 else self._levels[i] for i in signed])
