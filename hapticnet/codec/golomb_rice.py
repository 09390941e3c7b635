"""Golomb–Rice codes: small integers as few bits, with a parameter that follows their running mean.

Rice 1979: an integer u ≥ 0 becomes ``u >> k`` ones, a zero, and the lowest k bits of u. Signed integers are folded onto
0, 1, 2, … in the order 0, −1, 1, −2, 2, … (zig-zag). The parameter is the k of LOCO-I (Weinberger, Seroussi & Sapiro
2000; ITU-T T.87): the smallest with ``count · 2^k ≥ sum`` of the integers so far, in whole numbers only, so that both
sides get the same one on every machine.
"""

from collections.abc import Iterable, Sequence
from typing import Final

from hapticnet.errors import PeerError

LARGEST_PARAMETER: Final = 30

FORGET_ABOVE: Final = 32
"""Sum and count are halved when this many integers were counted, so that the mean follows the present (T.87: 64)."""


def pack_integers(integers: Iterable[int], parameter: int, *, most_bytes: int) -> bytes | None:
    """Return signed integers as Golomb–Rice codes, padded with zeros to whole bytes; None above `most_bytes`."""
    word, bits = 1, 0  # a leading one keeps the zeros that follow it
    for integer in integers:
        folded = 2 * integer if integer >= 0 else -2 * integer - 1
        ones = folded >> parameter
        bits += ones + 1 + parameter
        if bits > 8 * most_bytes:
            return None
        word = (((word << ones + 1) | (1 << ones + 1) - 2) << parameter) | (folded & (1 << parameter) - 1)
    size = (bits + 7) // 8
    return ((word << 8 * size - bits) ^ (1 << 8 * size)).to_bytes(size)


def unpack_integers(data: bytes, count: int, parameter: int) -> tuple[int, ...]:
    """Return the `count` integers in `data`.

    Raises
    ------
    PeerError
        When it ends too early, or holds more than the codes and their padding. Work and result are bounded by its
        length, whatever it holds.
    """
    left = 8 * len(data)
    word = int.from_bytes(data)
    integers: list[int] = []
    for _ in range(count):
        # Counted on the complement, whose highest one is the zero that ends the run.
        ones = left - (~word & (1 << left) - 1).bit_length()
        left -= ones + 1 + parameter
        if left < 0:
            raise PeerError(f"{len(data)} bytes end within their Golomb–Rice code {len(integers) + 1} of {count}")
        folded = ones << parameter | word >> left & (1 << parameter) - 1
        word &= (1 << left) - 1
        integers.append(folded >> 1 if folded % 2 == 0 else -(folded + 1 >> 1))
    if left > 7 or word:
        raise PeerError(f"{len(data)} bytes hold more than {count} Golomb–Rice codes with parameter {parameter}")
    return tuple(integers)


class RiceParameter:
    """The parameter that fits the integers so far."""

    __slots__ = ("_count", "_sum", "value")

    def __init__(self, first_mean: int) -> None:
        self._count = 1
        self._sum = first_mean
        self.value = 0
        self._fit()

    def add(self, integers: Sequence[int]) -> None:
        """Take in integers as they were coded."""
        for integer in integers:
            self._sum += 2 * integer if integer >= 0 else -2 * integer - 1
        self._count += len(integers)
        if self._count >= FORGET_ABOVE:
            self._count //= 2
            self._sum //= 2
        self._fit()

    def _fit(self) -> None:
        parameter = 0
        while self._count << parameter < self._sum and parameter < LARGEST_PARAMETER:
            parameter += 1
        self.value = parameter
