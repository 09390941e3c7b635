"""What a bank consists of: rows of sessions with their index, datagrams that arrive, and answers that depart."""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import IntArray
from hapticnet.protocol.frames import ADDRESS_WORDS, ANSWER_BYTES, SLOT_BYTES, Bytes

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


class Datagrams(NamedTuple):
    """Datagrams: bytes (n, space), lengths [B] (n,), and sources or destinations (n, ADDRESS_WORDS)."""

    octets: Bytes
    lengths: IntArray
    addresses: npt.NDArray[np.uint32]


class Tables(NamedTuple):
    """What a pass reads and changes beside the datagrams. They are few: each costs a call 0.1 µs.

    Attributes
    ----------
    rows
        The sessions.
    seals
        What seals and opens the datagrams of each row (`seal_steps`); zeros for open sessions.
    places
        Session numbers, FREE where there is none, and below each the place of its row; shape (2, a power of two).
    lists
        Lists of rows, WAITING, FOLLOWERS and LEAVING, each with its length as first number; shape (3, n + 1).
    state
        NEXT_US and DEPARTING; shape (2,).
    opened
        Space for the body of a datagram.
    repair
        The settings of the repair, one record.
    """

    rows: Any
    seals: IntArray
    places: IntArray
    lists: IntArray
    state: IntArray
    opened: Bytes
    repair: Any


NUMBERS, ROWS = range(2)

WAITING, FOLLOWERS, LEAVING = range(3)
"""Rows with a position to answer, in the order in which these arrived; rows whose scenes are stepped between positions;
rows that Python must step, because a new key begins."""

NEXT_US, DEPARTING = range(2)
"""When a scene is next due to be stepped between positions [µs], NEVER for none; how many answers are to be sent."""


def make_datagrams(count: int, space: int) -> Datagrams:
    """Return space for `count` datagrams of up to `space` bytes."""
    octets, lengths = np.zeros((count, space), np.uint8), np.zeros(count, np.int64)
    return Datagrams(octets, lengths, np.zeros((count, ADDRESS_WORDS), np.uint32))


def make_arrivals(count: int) -> Datagrams:
    """Return space for `count` datagrams that arrive."""
    return make_datagrams(count, SLOT_BYTES)


def make_departures(count: int) -> Datagrams:
    """Return space for `count` answers."""
    return make_datagrams(count, ANSWER_BYTES)


def append(lists: IntArray, which: int, at: int) -> None:
    """Add a row to a list."""
    lists[which, 0] += 1
    lists[which, lists[which, 0]] = at


def place_of_number(number: int, mask: int) -> int:
    """Return where the search for a session number in the index begins."""
    return (number * 40503 >> 16) & mask  # Fibonacci hashing (Knuth)


def find(tables: Tables, number: int) -> int:
    """Return the row of a session; FREE if there is none."""
    mask = tables.places.shape[1] - 1
    place = place_of_number(number, mask)
    while tables.places[NUMBERS, place] != FREE:
        if tables.places[NUMBERS, place] == number:
            return int(tables.places[ROWS, place])
        place = (place + 1) & mask
    return FREE
