"""How a worker sees the others, through the shared table."""

from collections import OrderedDict, deque
from collections.abc import Hashable
from typing import Any, Final

import numpy as np

from hapticnet.node.admission import worker_of
from hapticnet.node.reception import Address
from hapticnet.protocol.messages import Request
from hapticnet.protocol.settings import SessionSettings
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.workers.table import Table, name_parts

MOST_PLACED: Final = 4096
"""HELLOs of which it is remembered where they were passed on to, so that a repeated one goes there too."""

SEEN_AFTER_US: Final = 50_000
"""Time [µs] after which sessions that were sent to a worker are in its own count."""

STUCK_AFTER_US: Final = 1_000_000
"""Time [µs] without a refresh after which a worker gets no HELLOs."""


class Neighbourhood:
    """The others, for the node of one worker; see `node.neighbours.Neighbours`.

    A session goes to the worker that has the scene that it is to continue, or, if all places are taken, the session
    that is to give way; otherwise to the worker with the fewest sessions.

    A look at the table takes 0.1 ms for 2,000 sessions. Only what has passed `Reception` causes one.
    """

    def __init__(self, table: Table, worker: int, settings: SessionSettings) -> None:
        self._table = table
        self._worker = worker
        self._others = [number for number in range(len(table.workers)) if number != worker]
        self._settings = settings
        self._placed: OrderedDict[tuple[Address, int], int] = OrderedDict()
        self._sent: deque[tuple[int, int]] = deque()  # when, and to which worker

    def desk(self, host: Hashable) -> int | None:
        """Return the worker that counts the requests of a host; None if that is this one."""
        runs = self._runs()
        return self._other(int(runs[self._table.key(host) % len(runs)]))

    def placed(self, address: Address, nonce: int) -> int | None:
        """Return the other worker that a HELLO was given to before; None if it was not."""
        worker = self._placed.get((address, nonce))
        return worker if worker is not None and worker in self._runs() else None

    def place(self, address: Address, nonce: int, identity: Hashable, seats: int, request: Request) -> int | None:
        """Choose the worker for a session of `identity`, which may have so many `seats`; None if that is this one."""
        chosen = self._other(self._choose(identity, seats, request))
        if chosen is not None:
            self._placed[address, nonce] = chosen
            if len(self._placed) > MOST_PLACED:
                self._placed.popitem(last=False)
        return chosen

    def held(self, identity: Hashable) -> int:
        """Return how many sessions of an identity the others have."""
        rows = self._table.used_rows()[self._others]
        return int(np.count_nonzero((rows["identity"] == self._table.key(identity)) & (rows["taken"] == 1)))

    def taken(self) -> int:
        """Return how many sessions the others have."""
        return int(np.count_nonzero(self._table.used_rows()["taken"][self._others]))

    def expire(self) -> None:
        """Stop counting sessions as expected that their worker counts itself."""
        seen_us = now_us() - SEEN_AFTER_US
        while self._sent and self._sent[0][0] < seen_us:
            _, worker = self._sent.popleft()
            self._table.expected[self._worker, worker] -= 1

    def _other(self, worker: int) -> int | None:
        return None if worker == self._worker else worker

    def _runs(self) -> Any:
        """Return the numbers of the workers that serve; this one does."""
        runs = self._table.workers["seen_us"] > now_us() - STUCK_AFTER_US
        runs[self._worker] = True
        return np.flatnonzero(runs)

    def _choose(self, identity: Hashable, seats: int, request: Request) -> int:
        runs, now = self._runs(), now_us()
        if request.ticket is not None and (worker := worker_of(request.ticket, len(self._table.workers))) in runs:
            return worker
        rows = self._table.used_rows().copy()  # one moment's, for all that follows
        workers, places = np.nonzero(rows["taken"])
        found = rows[workers, places]
        silent_us = now - found["heard_us"]
        own = found["identity"] == self._table.key(identity)
        if request.ticket is None:
            same = own & (found["name"] == self._table.key(*name_parts(identity, request)))
            same &= silent_us > self._settings.stale_after_us
            if same.any():
                return int(workers[same][np.argmax(silent_us[same])])
        if np.count_nonzero(own) >= seats:
            candidates = own
        elif len(found) >= self._settings.most_sessions:
            _, index, counts = np.unique(found["identity"], return_inverse=True, return_counts=True)
            candidates = counts[index] > np.count_nonzero(own)
        else:
            return self._least(runs, now)
        candidates = candidates & (silent_us > self._settings.gives_way_us)
        if candidates.any():
            return int(workers[candidates][np.argmax(silent_us[candidates])])
        return self._worker  # which refuses

    def _least(self, runs: Any, now: int) -> int:
        """Return the worker with the fewest sessions, those included that are on their way there."""
        self.expire()
        load = self._table.workers["sessions"] + self._table.expected.sum(axis=0)
        chosen = int(runs[np.argmin(load[runs])])
        self._table.expected[self._worker, chosen] += 1
        self._sent.append((now, chosen))
        return chosen
