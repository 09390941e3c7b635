"""Numbers that wrap at 2³²: sequence numbers and microsecond time stamps (serial number arithmetic, RFC 1982)."""

from typing import Final

MODULUS: Final = 1 << 32
HALF: Final = 1 << 31
MOST: Final = MODULUS - 1


def wrap(number: int) -> int:
    """Return a number as it is on the wire, 0 to 2³² - 1."""
    return number & MOST


def distance(newer: int, older: int) -> int:
    """Return how far `newer` is ahead of `older`, from -2³¹ to 2³¹ - 1."""
    return ((newer - older + HALF) & MOST) - HALF


def unwrap(number: int, near: int) -> int:
    """Return the unwrapped number closest to the unwrapped number `near`."""
    return near + ((number - near + HALF) & MOST) - HALF
