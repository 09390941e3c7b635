"""What a bank consists of: rows of sessions with their index, datagrams that arrive, and answers that depart."""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import IntArray
from hapticnet.protocol.frames import ADDRESS_WORDS, ANSWER_BYTES, SLOT_BYTES, Bytes, Scratch

FREE: Final = -1
"""A place of the index that is empty."""

BANK_FIELDS: Final[list[Any]] = [
    ("address", np.uint32, (ADDRESS_WORDS,)),
    ("has_position", np.bool_),
    ("is_waiting", np.bool_),
    ("pending_us", np.int64),
    ("pending_m", np.float64),
    ("superseded", np.int64),
    ("steps", np.int64),
    ("stepped_us", np.int64),
    ("newest_us", np.int64),
    ("newest_m", np.float64),
    ("transmitted", np.bool_),
    ("samples", np.int64),
    ("squares", np.float64),
    ("largest_n", np.float64),
    ("exceeded", np.int64),
    ("codec_jnd_weber", np.float64),
    ("codec_jnd_floor_n", np.float64),
    ("idle_below_n", np.float64),
]
"""Fields of a row for the station itself: the position to answer, its account, and its error."""

Words = npt.NDArray[np.uint32]


class Arrivals(NamedTuple):
    """Datagrams that have arrived: bytes (n, SLOT_BYTES), lengths (n,), source addresses (n, ADDRESS_WORDS)."""

    data: Bytes
    lengths: IntArray
    addresses: Words


class Departures(NamedTuple):
    """Datagrams to send: bytes (n, ANSWER_BYTES), lengths (n,), destinations (n, ADDRESS_WORDS), how many (1,)."""

    data: Bytes
    lengths: IntArray
    addresses: Words
    number: IntArray


class Tables(NamedTuple):
    """What a pass reads and changes beside the datagrams.

    Attributes
    ----------
    rows
        The sessions.
    numbers, places
        Index of the rows: session numbers, FREE where there is none, and where their rows are.
    waiting
        Rows with a position to answer, in the order in which these arrived; the first number is how many.
    followers
        Rows whose scenes are stepped between positions; the first number is how many.
    leaving
        Rows that Python must step, because a new key begins; the first number is how many.
    seals
        What seals and opens the datagrams of each row (`seal_steps`); zeros for open sessions.
    opened
        Space for the body of a datagram.
    next_us
        When a scene is next due to be stepped between positions [µs], NEVER for none; shape (1,).
    scratch
        Space to convert floats.
    """

    rows: Any
    seals: IntArray
    numbers: IntArray
    places: IntArray
    waiting: IntArray
    followers: IntArray
    leaving: IntArray
    opened: Bytes
    next_us: IntArray
    scratch: Scratch


def make_arrivals(count: int) -> Arrivals:
    """Return space for `count` datagrams."""
    data = np.zeros((count, SLOT_BYTES), np.uint8)
    return Arrivals(data, np.zeros(count, np.int64), np.zeros((count, ADDRESS_WORDS), np.uint32))


def make_departures(count: int) -> Departures:
    """Return space for `count` answers."""
    data, lengths = np.zeros((count, ANSWER_BYTES), np.uint8), np.zeros(count, np.int64)
    return Departures(data, lengths, np.zeros((count, ADDRESS_WORDS), np.uint32), np.zeros(1, np.int64))


def place_of_number(number: int, mask: int) -> int:
    """Return where the search for a session number in the index begins."""
    return (number * 40503 >> 16) & mask  # Fibonacci hashing (Knuth): the numbers of a worker share their low bits


def find(tables: Tables, number: int) -> int:
    """Return the row of a session; FREE if there is none."""
    mask = tables.numbers.shape[0] - 1
    place = place_of_number(number, mask)
    while tables.numbers[place] != FREE:
        if tables.numbers[place] == number:
            return int(tables.places[place])
        place = (place + 1) & mask
    return FREE
