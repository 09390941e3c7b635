"""Running totals on the wire, in 32 bits that wrap: a packet that is lost, late or there twice changes no sum."""

import math
import struct
from typing import Final

from hapticnet.errors import PeerError
from hapticnet.samples import Vector

BYTES: Final = 4  # of a total
_ALL: Final = 1 << 32
_HALF: Final = 1 << 31


def packed(totals: Vector, step: float) -> bytes:
    """Return totals as counts of `step`, rounded down, modulo 2³²."""
    return struct.pack(f">{len(totals)}I", *(math.floor(total / step) % _ALL for total in totals))


class Totals:
    """Totals of the other end, read from the newest packet; between two packets each moves by less than 2³¹ steps."""

    def __init__(self, count: int, step: float) -> None:
        self._counts, self._step = [0] * count, step

    def receive(self, data: bytes) -> Vector:
        """Return the totals; raise PeerError if the data does not have their length."""
        if len(data) != BYTES * len(self._counts):
            raise PeerError(f"{len(data)} bytes before the payload instead of {BYTES * len(self._counts)}")
        wrapped = struct.unpack(f">{len(self._counts)}I", data)
        for place, count in enumerate(wrapped):
            self._counts[place] += (count - self._counts[place] + _HALF) % _ALL - _HALF
        return tuple([self._step * count for count in self._counts])
