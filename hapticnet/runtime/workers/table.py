"""The table that workers share: who has which sessions. Each writes its own rows and reads all."""

import mmap
import os
from collections.abc import Hashable
from hashlib import blake2s
from typing import Any, Final

import numpy as np

from hapticnet.protocol.messages import Request

WORKER: Final = np.dtype([("seen_us", "i8"), ("sessions", "i8"), ("top", "i8")])
"""What there is of each worker: when its loop ran last (0: it does not), its sessions, half-open ones included, and how
many of its rows from the first on were ever used."""

COUNT: Final = np.dtype("i8")

ROW: Final = np.dtype([("taken", "u8"), ("identity", "u8"), ("name", "u8"), ("heard_us", "i8")])
"""One session: whether the row is used, hashes of identity and of identity and name, when its master was last heard."""


class Table:
    """Sessions of all workers in shared memory.

    Parameters
    ----------
    descriptor
        A file of `size` bytes; the same one in every process.
    seats
        Most sessions of all workers together.
    secret
        Key of the hashes, so that no stranger can choose what collides.

    Attributes
    ----------
    workers, rows
        What there is of each worker, `WORKER`, shape (workers,), and its sessions, `ROW`, shape (workers, seats).
    expected
        Sessions that each worker has lately sent to each other one, shape (workers, workers).
    """

    def __init__(self, descriptor: int, workers: int, seats: int, secret: bytes) -> None:
        memory = mmap.mmap(descriptor, size(workers, seats))
        self.workers: Any = np.frombuffer(memory, WORKER, workers)
        at = workers * WORKER.itemsize
        self.expected: Any = np.frombuffer(memory, COUNT, workers * workers, at).reshape(workers, workers)
        at += workers * workers * COUNT.itemsize
        self.rows: Any = np.frombuffer(memory, ROW, workers * seats, at).reshape(workers, seats)
        self._secret = secret

    def used_rows(self) -> Any:
        """Return the rows of all workers without those that were never used, shape (workers, n)."""
        return self.rows[:, : int(self.workers["top"].max())]

    def key(self, *parts: Hashable) -> int:
        """Return the hash of an identity, or of an identity and a name."""
        digest = blake2s(repr(parts).encode(), key=self._secret, digest_size=8, person=b"table").digest()
        return int.from_bytes(digest, "big")

    def sessions_of(self, worker: int) -> int:
        """Return how many seats the sessions of a worker have, at this moment."""
        return int(np.count_nonzero(self.rows["taken"][worker]))

    def clear(self, worker: int) -> None:
        """Forget the sessions of a worker that has ended."""
        self.workers[worker] = 0
        self.expected[worker] = 0
        self.rows[worker] = 0


def size(workers: int, seats: int) -> int:
    """Return the bytes of a table."""
    return int(workers * (WORKER.itemsize + workers * COUNT.itemsize + seats * ROW.itemsize))


def shared_file(workers: int, seats: int) -> int:
    """Return a descriptor of memory for a table: anonymous, freed with its last user."""
    descriptor = os.memfd_create("hapticnet")
    os.ftruncate(descriptor, size(workers, seats))
    return descriptor


def name_parts(identity: Hashable, request: Request) -> tuple[Hashable, ...]:
    """Return what identifies a restarted master."""
    return identity, request.name
