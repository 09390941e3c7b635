"""Sort the datagrams of one direction by sequence number: new, late, duplicate, astray or lost."""

import enum
from typing import Final

from hapticnet.protocol.members import plain_members
from hapticnet.protocol.serial_number import distance, wrap

WINDOW: Final = 1024
"""Sequence numbers remembered below the newest: one second at 1 kHz, longer than reordering lasts. Older ones count as
late."""

LEAP: Final = 3000
"""A number this far from the newest is not believed until the one after it comes next: otherwise one datagram with a
wrong number would make all true ones late (MAX_DROPOUT of RFC 3550, appendix A.1)."""

MISORDER: Final = 100
"""Largest disorder that a network causes (MAX_MISORDER of RFC 3550)."""

BEHIND_IN_A_ROW: Final = 8
"""After so many arrivals in a row more than `MISORDER` behind the newest, each newer than the one before it, the newest
was wrong: the numbers go on from there."""


@plain_members
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
    authentic
        Whether a seal proves each number. Every number is then believed at once.
    """

    __slots__ = ("_after_leap", "_authentic", "_behind", "_behind_run", "_expected", "_newest", "_seen", "_unique")

    def __init__(self, first: int, *, authentic: bool = False) -> None:
        self._newest = first
        self._seen = 1  # bit i: the sequence number i below the newest has arrived
        self._expected = 1
        self._unique = 1
        self._authentic = authentic
        self._after_leap: int | None = None
        self._behind = first  # the last arrival far behind the newest
        self._behind_run = 0

    @property
    def lost(self) -> int:
        """Datagrams sent before the newest one that have not arrived (yet)."""
        return self._expected - self._unique

    def arrive(self, sequence: int) -> Arrival:
        """Record an arrival and return its kind."""
        if sequence - self._newest == 1:  # the common case, kept short
            self._seen = (self._seen << 1 | 1) & _MASK
            self._after_leap = None
            self._behind_run = 0
            self._newest = sequence
            self._expected += 1
            self._unique += 1
            return _NEW
        ahead = distance(sequence, self._newest)
        if ahead == 1:
            self._seen = (self._seen << 1 | 1) & _MASK
        elif ahead <= 0 and (self._authentic or ahead > -LEAP):
            kind = self._arrive_behind(-ahead)
            if kind is not Arrival.LATE or not self._newest_was_wrong(sequence, -ahead):
                return kind
            self._seen = 1
            ahead = 1
        elif self._authentic or (ahead < LEAP and ahead > 0):
            self._seen = (self._seen << ahead | 1) & _MASK if ahead < WINDOW else 1
        elif wrap(sequence) == self._after_leap:
            self._seen = 1
            ahead = max(ahead, 1)
        else:
            self._after_leap = wrap(sequence + 1)
            return Arrival.ASTRAY
        self._after_leap = None
        self._behind_run = 0
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

    def _newest_was_wrong(self, sequence: int, behind: int) -> bool:
        if self._authentic or behind <= MISORDER:
            return False
        self._behind_run = self._behind_run + 1 if distance(sequence, self._behind) > 0 else 1
        self._behind = wrap(sequence)
        return self._behind_run >= BEHIND_IN_A_ROW


_MASK = (1 << WINDOW) - 1
_NEW: Final = Arrival.NEW
