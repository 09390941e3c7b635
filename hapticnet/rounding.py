"""Rounding of numbers for the wire. Each function has a second, compiled body in `compiled`."""

import struct
from typing import Final

SINGLE: Final = struct.Struct(">f")
HALF: Final = struct.Struct(">e")


def as_single(x: float) -> float:
    """Return the float32 nearest to a number within its range, halves to even."""
    rounded: float
    (rounded,) = SINGLE.unpack(SINGLE.pack(x))
    return rounded


def as_half(x: float) -> float:
    """Return the float16 nearest to a number within ±65504, halves to even."""
    rounded: float
    (rounded,) = HALF.unpack(HALF.pack(x))
    return rounded


def nearest(x: float) -> float:
    """Return the whole number nearest to a finite number, halves to even."""
    return round(x)
