"""Sort the datagrams of one direction by sequence number: new, late, duplicate, astray or lost."""

import enum
from typing import Final

from hapticnet.protocol.serial_number import distance, wrap

WINDOW: Final = 1024
"""Sequence numbers remembered below the newest: one second at 1 kHz, longer than reordering lasts. Older ones count as
late."""

LEAP: Final = 1 << 15
"""A number this far ahead or behind is not believed until the one after it comes next (RFC 3550, appendix A.1):
otherwise one datagram with a wrong number would make all true ones late. Half a minute at 1 kHz."""


class Arrival(enum.Enum):
    """How a sequence number relates to the earlier ones."""

    NEW = "new"
    LATE = "late"
    DUPLICATE = "duplicate"
    ASTRAY = "astray"


class ArrivalWindow:
    """Sort arrivals by sequence number and count those that are missing.

    Parameters
    ----------
    first
        The sequence number of the datagram that opened the session; it counts as arrived.
    """

    __slots__ = ("_after_leap", "_expected", "_newest", "_seen", "_unique")

    def __init__(self, first: int) -> None:
        self._newest = first
        self._seen = 1  # bit i: the sequence number i below the newest has arrived
        self._expected = 1
        self._unique = 1
        self._after_leap: int | None = None

    @property
    def lost(self) -> int:
        """Datagrams sent before the newest one that have not arrived (yet)."""
        return self._expected - self._unique

    def arrive(self, sequence: int) -> Arrival:
        """Record an arrival and return its kind."""
        ahead = distance(sequence, self._newest)
        if ahead == 1:  # the common case, kept short
            self._seen = (self._seen << 1 | 1) & _MASK
        elif wrap(sequence) == self._after_leap:
            self._seen = 1
            ahead = max(ahead, 1)
        elif abs(ahead) >= LEAP:
            self._after_leap = wrap(sequence + 1)
            return Arrival.ASTRAY
        elif ahead > 0:
            self._seen = (self._seen << ahead | 1) & _MASK if ahead < WINDOW else 1
        else:
            return self._arrive_behind(-ahead)
        self._after_leap = None
        self._newest = wrap(sequence)
        self._expected += ahead
        self._unique += 1
        return Arrival.NEW

    def _arrive_behind(self, behind: int) -> Arrival:
        if behind >= WINDOW:
            return Arrival.LATE
        if self._seen >> behind & 1:
            return Arrival.DUPLICATE
        self._seen |= 1 << behind
        # A datagram sent before the session opened was not expected, so its arrival replaces no lost one.
        if self.lost:
            self._unique += 1
        return Arrival.LATE


_MASK = (1 << WINDOW) - 1
