"""Golomb-Rice codes: small integers as few bits.

Rice 1979: an integer u ≥ 0 becomes ``u >> k`` ones, a zero, and the lowest k bits of u. The parameter k that
fits is the one of LOCO-I (Weinberger, Seroussi & Sapiro 2000; ITU-T T.87): see `residuals`.
"""

from collections.abc import Iterable

from hapticnet.errors import PeerError


def bits_of(integer: int, parameter: int) -> int:
    """Return the length of the code of an integer."""
    return (integer >> parameter) + 1 + parameter


def pack_integers(integers: Iterable[int], parameter: int) -> bytes:
    """Return integers from 0 on as Golomb-Rice codes, padded with zeros to whole bytes."""
    word, bits = 1, 0  # a leading one keeps the zeros that follow it
    for integer in integers:
        ones = integer >> parameter
        bits += bits_of(integer, parameter)
        word = (((word << ones + 1) | (1 << ones + 1) - 2) << parameter) | (integer & (1 << parameter) - 1)
    size = (bits + 7) // 8
    return ((word << 8 * size - bits) ^ (1 << 8 * size)).to_bytes(size)


def unpack_integers(data: bytes, count: int, parameter: int) -> tuple[int, ...]:
    """Return the `count` integers in `data`.

    Raises
    ------
    PeerError
        If the data ends too early, or holds more than the codes and their padding. Work and result are bounded by its
        length.
    """
    left = 8 * len(data)
    word = int.from_bytes(data)
    integers: list[int] = []
    for _ in range(count):
        # Counted on the complement, whose highest one is the zero that ends the run.
        ones = left - (~word & (1 << left) - 1).bit_length()
        left -= ones + 1 + parameter
        if left < 0:
            raise PeerError(f"{len(data)} bytes end within their Golomb-Rice code {len(integers) + 1} of {count}")
        integers.append(ones << parameter | word >> left & (1 << parameter) - 1)
        word &= (1 << left) - 1
    if left > 7 or word:
        raise PeerError(f"{len(data)} bytes hold more than {count} Golomb-Rice codes with parameter {parameter}")
    return tuple(integers)
