"""How a worker shows its sessions to the others, in the shared table."""

import asyncio
from typing import TYPE_CHECKING, Final

from hapticnet.node.slave import SlaveNode
from hapticnet.node.slave_events import MasterJoined, MasterLeft, SlaveEvent
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.watching import Watcher
from hapticnet.runtime.workers.neighbourhood import Neighbourhood
from hapticnet.runtime.workers.table import Table, name_parts

if TYPE_CHECKING:
    from hapticnet.node.station import Station

REFRESH_S: Final = 0.02

MOST_AT_ONCE: Final = 64
"""Sessions of which it is shown every `REFRESH_S` when their masters were last heard: 0.1 ms. 320 take 0.1 s."""


class Presence(Watcher[SlaveEvent]):
    """Show the sessions of a worker: a seat at once, silence in turns.

    Parameters
    ----------
    neighbours
        How this worker sees the others.
    """

    name = "table of workers"

    def __init__(self, node: SlaveNode, table: Table, worker: int, neighbours: Neighbourhood) -> None:
        self._neighbours = neighbours
        self._node = node
        self._table = table
        self._worker = worker
        self._rows: dict[Station, int] = {}
        self._due: list[Station] = []
        self._free = list(range(table.rows.shape[1] - 1, -1, -1))
        self._handle: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Tell that this worker serves."""
        self._table.clear(self._worker)
        self._fire()

    def note(self, event: SlaveEvent, now_us: int) -> None:
        """Take or free a row."""
        rows = self._table.rows
        if isinstance(event, MasterJoined) and self._free:
            station = event.station
            row = self._rows[station] = self._free.pop()
            self._table.workers["top"][self._worker] = max(row + 1, self._table.workers["top"][self._worker])
            identity, parts = station.identity, name_parts(station.identity, station.session.request)
            rows[self._worker, row] = (1, self._table.key(identity), self._table.key(*parts), now_us)
        elif isinstance(event, MasterLeft) and (left := self._rows.pop(event.station, None)) is not None:
            rows["taken"][self._worker, left] = 0
            self._free.append(left)

    async def stop(self) -> None:
        """Tell that this worker no longer serves."""
        if self._handle is not None:
            self._handle.cancel()
        self._table.clear(self._worker)

    def refresh(self) -> None:
        """Show that this worker runs, how many sessions it has, and when some of their masters were last heard."""
        self._neighbours.expire()
        own = self._table.workers[self._worker]
        own["seen_us"], own["sessions"] = now_us(), self._node.session_count
        self._due = self._due or list(self._rows)
        now, heard_us = now_us(), self._table.rows["heard_us"][self._worker]
        some, self._due = self._due[:MOST_AT_ONCE], self._due[MOST_AT_ONCE:]
        for station in some:
            if (row := self._rows.get(station)) is not None:
                heard_us[row] = now - station.session.silent_us(now)

    def _fire(self) -> None:
        self._handle = asyncio.get_running_loop().call_later(REFRESH_S, self._fire)
        self.refresh()
