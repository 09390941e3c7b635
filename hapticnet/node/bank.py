"""Sessions as rows of numbers, all served in one compiled pass (docs/adr/0013).

A bank holds the sessions whose scene and codec can be stepped by compiled code. Their stations remain, but are out of
date until `take_out` or `refresh` copies the row back.
"""

from collections.abc import Callable, Hashable
from typing import Any, Protocol

import numpy as np

from hapticnet.arrays import IntArray
from hapticnet.compiled import compiled
from hapticnet.node.bank_rows import ACCOUNT, ROW, account_to_station, station_from_row, station_to_row
from hapticnet.node.bank_steps import serve, step_between_all
from hapticnet.node.bank_tables import (
    DEPARTING,
    FOLLOWERS,
    FREE,
    LEAVING,
    NEXT_US,
    Datagrams,
    Tables,
    append,
    make_arrivals,
    make_departures,
    place_of_number,
)
from hapticnet.node.course_steps import NEVER
from hapticnet.node.station import Station
from hapticnet.protocol.frames import SLOT_BYTES
from hapticnet.protocol.repair import RepairSettings
from hapticnet.protocol.repair_steps import repair_record
from hapticnet.protocol.seal_steps import COLUMNS, RowSeal

Words = Any
"""An address as `frames.ADDRESS_WORDS` numbers of 32 bits."""


class AddressBook(Protocol):
    """Turns addresses into words and back."""

    def words(self, address: Hashable) -> Words:
        """Return an address as words, the same for the same address."""
        ...

    def address(self, words: Words) -> Hashable:
        """Return the address that was made into words."""
        ...


class Bank:
    """The rows and their index.

    Parameters
    ----------
    most
        Sessions at once.
    repair
        How lost updates are repaired; the same for all sessions.
    addresses
        Turns the addresses of stations into words and back.
    is_compiled
        Whether the passes are compiled (the ``fast`` extra); else the same functions run as plain Python.

    Attributes
    ----------
    departures
        The answers of the newest passes, the first `departing` of them.
    """

    def __init__(self, most: int, repair: RepairSettings, addresses: AddressBook, *, is_compiled: bool = True) -> None:
        self.departures = make_departures(most)
        self._addresses = addresses
        self._stations: list[Station | None] = [None] * most
        self._free = list(range(most - 1, -1, -1))
        self._seals: dict[int, RowSeal] = {}
        size = 1 << max(4, (2 * most).bit_length())
        self._tables = Tables(
            rows=np.zeros(most, ROW).view(np.recarray),
            seals=np.zeros((most, COLUMNS), np.int64),
            places=np.full((2, size), FREE, np.int64),
            lists=np.zeros((3, most + 1), np.int64),
            state=np.array([NEVER, 0]),
            opened=np.zeros(SLOT_BYTES, np.uint8),
            repair=repair_record(repair),
        )
        make: Callable[[Any], Any] = compiled if is_compiled else _as_it_is
        self._serve, self._step = make(serve), make(step_between_all)
        self._warm_up()

    def __len__(self) -> int:
        """Return the number of sessions in the bank."""
        return len(self._stations) - len(self._free)

    def __contains__(self, station: Station) -> bool:
        """Tell whether a station is in the bank."""
        return station.row is not None

    @property
    def departing(self) -> int:
        """How many answers are to be sent."""
        return int(self._tables.state[DEPARTING])

    def departed(self) -> None:
        """Note that all answers were sent, or taken elsewhere."""
        self._tables.state[DEPARTING] = 0

    def serve(self, arrivals: Datagrams, first: int, count: int, now_us: int, *, answers: bool = True) -> int:
        """Take in datagrams from number `first` to `count` - 1 and then answer, unless `answers` is False.

        Return the number of the first one that is not usual, before any answer, or `count`.
        """
        return int(self._serve(self._tables, arrivals, self.departures, first, count, answers, now_us))

    def step_between(self, now_us: int) -> list[Station]:
        """Step scenes between positions that are few; return the stations that Python must step this time."""
        lists = self._tables.lists
        if not lists[FOLLOWERS, 0]:
            return []
        self._step(self._tables, self.departures, now_us)
        return [self._station(int(at)) for at in lists[LEAVING, 1 : lists[LEAVING, 0] + 1]]

    def next_step_us(self) -> int | None:
        """Return when `step_between` may have something to do [µs]; None if there is nothing to follow."""
        next_us = int(self._tables.state[NEXT_US])
        return None if next_us == NEVER or not self._tables.lists[FOLLOWERS, 0] else next_us

    def put_in(self, station: Station) -> None:
        """Take over a station that fits. What raises leaves it outside, and the row free."""
        at = self._free[-1]
        row = self._tables.rows[at]
        station_to_row(station, row)
        row.address[:] = self._addresses.words(station.address)
        seal = station.session.seal
        if seal is not None:
            self._seals[at] = RowSeal(seal, self._tables.seals[at])
        self._free.pop()
        self._stations[at] = station
        self._index(station.session.number, at)
        if station.course is not None:
            append(self._tables.lists, FOLLOWERS, at)
            next_us = int(self._tables.state[NEXT_US])  # at the next tick, the pass finds out
            self._tables.state[NEXT_US] = station._stepped_us if next_us == NEVER else min(station._stepped_us, next_us)
        station.row = at
        station.session.row = row

    def take_out(self, station: Station) -> None:
        """Give a station back to Python, up to date."""
        self.refresh(station)
        at = station.row
        assert at is not None, "the station is in the bank"  # noqa: S101 - the caller's fault
        station.row = station.session.row = None
        row = self._tables.rows[at]
        row.has_position = False
        if at in self._seals:
            self._seals.pop(at).release(self._tables.seals[at])
        if station.course is not None:
            _remove(self._tables.lists[FOLLOWERS], at)
        self._unindex(station.session.number)
        self._stations[at] = None
        self._free.append(at)

    def refresh(self, station: Station) -> None:
        """Bring a station up to date; it stays in the bank."""
        assert station.row is not None, "the station is in the bank"  # noqa: S101 - the caller's fault
        row = self._tables.rows[station.row]
        station_from_row(station, row)
        if station.session.seal is not None:
            station.address = self._addresses.address(row.address)
            self._seals[station.row].load(station.session.seal, self._tables.seals[station.row])

    def refresh_accounts(self) -> None:
        """Bring only the accounts of the stations up to date: for a thousand this takes a millisecond."""
        stations = [station for station in self._stations if station is not None]
        used = [station.row for station in stations]
        columns = [self._tables.rows[name][used].tolist() for name in ACCOUNT]
        for station, *counts in zip(stations, *columns, strict=True):
            account_to_station(station, counts)

    def totals(self) -> tuple[int, int]:
        """Return the steps of the sessions in the bank, and the datagrams that were sent in them."""
        used = [at for at, station in enumerate(self._stations) if station is not None]
        rows = self._tables.rows
        return int(rows["steps"][used].sum()), int(rows["sent_packets"][used].sum())

    def _station(self, at: int) -> Station:
        station = self._stations[at]
        assert station is not None, "the row is in use"  # noqa: S101 - for the type checker
        return station

    def _index(self, number: int, at: int) -> None:
        numbers, rows = self._tables.places
        mask = len(numbers) - 1
        place = place_of_number(number, mask)
        while numbers[place] != FREE:
            place = (place + 1) & mask
        numbers[place], rows[place] = number, at

    def _unindex(self, number: int) -> None:
        """Remove a number, and move those after it up: a search stops at a gap."""
        numbers, rows = self._tables.places
        mask = len(numbers) - 1
        place = place_of_number(number, mask)
        while numbers[place] != number:
            place = (place + 1) & mask
        numbers[place] = FREE
        place = (place + 1) & mask
        while numbers[place] != FREE:
            moved = int(numbers[place])
            numbers[place] = FREE
            self._index(moved, int(rows[place]))
            place = (place + 1) & mask

    def _warm_up(self) -> None:
        """Compile before the first datagram waits for it."""
        self.serve(make_arrivals(1), 0, 0, 0)
        self._step(self._tables, self.departures, 0)


def _as_it_is(function: Any) -> Any:
    return function


def _remove(list_of_rows: IntArray, at: int) -> None:
    last = list_of_rows[0]
    place = int(np.flatnonzero(list_of_rows[1 : last + 1] == at)[0]) + 1
    list_of_rows[place] = list_of_rows[last]
    list_of_rows[0] -= 1
