"""A slave whose usual sessions are served by a bank, and all others as by `SlaveNode`, with the same bytes."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from hapticnet.errors import PeerError
from hapticnet.node.bank import AddressBook, Bank
from hapticnet.node.bank_rows import can_fit, fits_now
from hapticnet.node.bank_tables import Datagrams, make_arrivals
from hapticnet.node.reception import Address
from hapticnet.node.slave import SlaveNode
from hapticnet.node.station import Station
from hapticnet.protocol.session_steps import DUPLICATE, LATE, arrived, count_malformed, count_received, sort
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES, Datagram, Kind

MOST_AT_ONCE: Final = 256
"""Datagrams of one pass."""

SHORTEST_TICK_US: Final = 400
"""Shortest time between two ticks that step scenes between positions: many sessions share one, and each step is late by
less than half a sample of 1 kHz."""

SHORTEST_STAY_US: Final = 1_000_000
"""A session that leaves the bank sooner than this stays outside for a while: moving it costs as much as several
positions."""

FIRST_WAIT_US: Final = 20_000
LONGEST_WAIT_US: Final = 10_000_000
"""Shortest and longest time outside; it doubles with each short stay."""


class CompiledSlaveNode(SlaveNode):
    """Serve masters, as many as possible in one compiled pass.

    Parameters
    ----------
    addresses
        Turns the addresses of datagrams into words and back.
    is_compiled
        Whether the passes are compiled (the ``fast`` extra); else the same functions run as plain Python.
    **others
        As for `SlaveNode`.
    """

    def __init__(self, *given: Any, addresses: AddressBook, is_compiled: bool = True, **others: Any) -> None:
        super().__init__(*given, **others)
        session = self._settings.session
        self._addresses = addresses
        self._bank = Bank(session.most_sessions, session.repair, addresses, is_compiled=is_compiled)
        self._arrivals = make_arrivals(MOST_AT_ONCE)
        self._in_python: set[Station] = set()  # stations that Python has served since the last `settle`
        self._since_us: dict[Station, int] = {}  # when each went into the bank
        self._waits: dict[Station, tuple[int, int]] = {}  # until when each stays outside, and for how long in all
        self._ticked_us = self._now_us = 0
        self._is_quiet = True
        self._older = 0  # datagrams of the outbox that come before the bank's present answers

    @property
    def stations(self) -> tuple[Station, ...]:
        """The present sessions; of those in the bank, only what they count is up to date."""
        self._bank.refresh_accounts()
        return super().stations

    def totals(self) -> tuple[int, int]:
        """Return the steps of all present sessions, and the datagrams that were sent in them; as `SlaveNode.totals`."""
        outside = [each for each in super().stations if each not in self._bank]
        steps, packets = self._bank.totals()
        return steps + sum(each.steps for each in outside), packets + sum(each.session.sent.packets for each in outside)

    def receive_datagrams(self, batch: Iterable[tuple[bytes, Address]], now_us: int) -> None:
        """Process what has arrived since the last call; as `SlaveNode.receive_datagrams`."""
        self._see(now_us)
        self._make_room()
        pieces = list(batch)
        for first in range(0, len(pieces), MOST_AT_ONCE):
            count = 0
            for data, address in pieces[first : first + MOST_AT_ONCE]:
                kept = data[: MAX_DATAGRAM_BYTES + 1]
                self._arrivals.octets[count, : len(kept)] = np.frombuffer(kept, np.uint8)
                self._arrivals.lengths[count] = len(kept)
                self._arrivals.addresses[count] = self._addresses.words(address)
                count += 1
            self._serve(self._arrivals, count, now_us, answers=first + MOST_AT_ONCE >= len(pieces))
        self._answer_all(now_us)

    def receive_arrivals(self, arrivals: Datagrams, count: int, now_us: int) -> None:
        """Process the first `count` datagrams of `arrivals`; as `receive_datagrams`."""
        self._see(now_us)
        self._make_room()
        self._serve(arrivals, count, now_us, answers=True)
        if self._to_answer:
            self._answer_all(now_us)

    def settle(self, now_us: int) -> None:
        """Account for the answers of sessions outside the bank, and take those in that fit."""
        super().settle(now_us)
        self._is_quiet = True
        for station in self._in_python:
            if self._may_go_in(station, now_us):
                self._bank.put_in(station)
                self._steps.forget(station)
                self._since_us[station] = now_us
        self._in_python.clear()

    def tick(self, now_us: int) -> None:
        """Forget sessions that have long been silent, and step scenes between positions."""
        self._see(now_us)
        self._ticked_us = now_us
        self._expire(now_us)  # before the bank steps their scenes
        self._make_room()
        for station in self._bank.step_between(now_us):
            self._at_hand(station)
            self._is_quiet = False
        python_us = super().next_timer_us()
        if python_us is not None and python_us <= now_us:
            self._is_quiet = False
            super().tick(now_us)

    def next_timer_us(self) -> int | None:
        """Return when `tick` may have something to do [µs]; None if there is no session."""
        next_us, step_us = super().next_timer_us(), self._bank.next_step_us()
        if step_us is None:
            return next_us
        step_us = max(step_us, self._ticked_us + SHORTEST_TICK_US)
        return step_us if next_us is None else min(step_us, next_us)

    @property
    def is_quiet(self) -> bool:
        """Whether the bank has served all since the last `settle`: there is nothing to do but to send `departures`."""
        return self._is_quiet

    @property
    def follows(self) -> bool:
        """Whether the bank steps scenes between positions."""
        return self._bank.next_step_us() is not None

    def take_departures(self) -> tuple[Datagrams, int]:
        """Return the answers of the bank, and how many; send them at once, before `datagrams_to_send`."""
        count = self._bank.departing
        self._bank.departed()
        return self._bank.departures, count

    def datagrams_to_send(self) -> list[tuple[bytes, Address]]:
        """Return the datagrams to send now, with their destinations."""
        self._make_room()
        self._older = 0
        return super().datagrams_to_send()

    def report(self) -> dict[str, Any]:
        """Return the account of the sessions for JSON; as `SlaveNode.report`."""
        for station in self.stations:
            if station in self._bank:
                self._bank.refresh(station)
        return super().report()

    def _serve(self, arrivals: Datagrams, count: int, now_us: int, *, answers: bool) -> None:
        number = 0
        while (number := self._bank.serve(arrivals, number, count, now_us, answers=answers)) < count:
            data = arrivals.octets[number, : arrivals.lengths[number]].tobytes()
            self._take_in(data, self._addresses.address(arrivals.addresses[number]), now_us)
            self._is_quiet = False
            number += 1

    def _see(self, now_us: int) -> None:
        """Take in the time."""
        self._seats.see(now_us)
        self._now_us = now_us
        self._ticked_us = min(self._ticked_us, now_us)  # a clock that went back must not hold up the next tick

    def _make_room(self) -> None:
        """Move the answers of the bank to the outbox: there is room for one of each session, and no check."""
        departures, count = self.take_departures()
        if count:
            self._outbox[self._older : self._older] = [
                (
                    departures.octets[number, : departures.lengths[number]].tobytes(),
                    self._addresses.address(departures.addresses[number]),
                )
                for number in range(count)
            ]
            self._is_quiet = False
        self._older = len(self._outbox)

    def _answer_all(self, now_us: int) -> None:
        self._in_python.update(self._to_answer)
        super()._answer_all(now_us)

    def _at_hand(self, station: Station, datagram: Datagram | None = None, data: bytes = b"") -> bool:
        if station not in self._bank:
            return True
        if datagram is not None and _is_only_counted(station, datagram, data):
            return False
        self._bank.take_out(station)
        self._is_quiet = False
        self._in_python.add(station)
        self._steps.note(station)
        if station.waits:
            self._to_answer.append(station)
        now_us = self._now_us
        stayed_us = now_us - self._since_us.pop(station)
        if 0 <= stayed_us < SHORTEST_STAY_US:
            _, wait_us = self._waits.get(station, (0, FIRST_WAIT_US // 2))
            wait_us = min(2 * wait_us, LONGEST_WAIT_US)
            self._waits[station] = now_us + wait_us, wait_us
        else:
            self._waits.pop(station, None)
        return True

    def _may_go_in(self, station: Station, now_us: int) -> bool:
        if self._stations.get(station.session.number) is not station or not can_fit(station):
            return False
        until_us, wait_us = self._waits.get(station, (now_us, 0))
        return not 0 < until_us - now_us <= wait_us and fits_now(station)

    def _remove(self, station: Station) -> None:
        super()._remove(station)
        self._waits.pop(station, None)
        self._is_quiet = False


def _is_only_counted(station: Station, datagram: Datagram, data: bytes) -> bool:
    """Return whether a datagram of a sealed session was forged or replayed; it is then counted in the session's row.

    It must not cost the session this row.
    """
    seal, row = station.session.seal, station.session.row
    if seal is None:
        return False
    try:
        seal.open(data, datagram)
    except PeerError:
        count_malformed(row, len(data))
        return True
    arrival = sort(row, datagram.sequence)
    if datagram.kind is not Kind.POSITION or arrival not in (DUPLICATE, LATE):
        return False
    count_received(row, len(data))
    arrived(row, datagram.sequence, arrival)
    return True
