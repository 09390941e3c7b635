"""Statistics of datagrams: order and loss of sequence numbers, counters, distributions."""

import enum
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind, distance, plain_members, wrap

WINDOW: Final = 1024
"""Sequence numbers remembered below the newest: one second at 1 kHz, longer than reordering lasts. Older ones count as
late."""

LEAP: Final = 3000
"""A number this far from the newest is not accepted until the following one comes next: otherwise one datagram with a
wrong number would make all genuine ones late (MAX_DROPOUT of RFC 3550, appendix A.1)."""

MISORDER: Final = 100  # largest disorder that a network causes (MAX_MISORDER of RFC 3550)
BEHIND_IN_A_ROW: Final = 8
"""After this many arrivals in a row more than `MISORDER` behind the newest, each newer than the one before, the newest
was wrong: the numbers continue from there."""


@plain_members
class Arrival(enum.Enum):
    """How a sequence number relates to the earlier ones."""

    NEW = "new"
    LATE = "late"
    DUPLICATE = "duplicate"
    ASTRAY = "astray"


class ArrivalWindow:
    """Sort arrivals by sequence number and count those that are missing.

    `first`: the sequence number of the datagram that opened the session; it counts as arrived.
    `authentic`: whether a seal proves each number. Every number is then accepted at once.
    """

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
        # A datagram sent before the session opened was not expected, so its arrival does not reduce the losses.
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


REPORT_STEPS: Final = 100  # a report counts in whole per cents, so that each of its numbers takes one byte
REPORT_EVERY: Final = 16
"""While there is loss to report, one POSITION in this many carries a report: 125 bytes a second at 1 kHz."""

REORDERED: Final = 3
"""A datagram counts as lost once the third after it has arrived (kPacketThreshold of RFC 9002, section 6.1.1)."""

MEMORY: Final = 512
"""Datagrams over which the share of losses averages: ten seconds of a quiet stream, two of a paced one."""

REMEMBERED_LOSSES: Final = 256
"""Losses over which the length of bursts averages. The number of datagrams needed depends on it most."""

ASSUMED_ARRIVED: Final = 32.0
"""Datagrams assumed to have arrived before the first, so that one early loss does not look like 50 %."""

ASSUMED_LOST: Final = 2.0
"""Losses assumed before the first when bursts are estimated; half of them are followed by another loss."""

MOST_DATAGRAMS: Final = 200


class Loss(NamedTuple):
    """A chain of two states that steps with each datagram (Gilbert 1960, see `channel.settings`)."""

    share: float  # share of the datagrams that are lost, 0 to 1
    again: float  # share of the losses after which the next datagram is lost too: 1 - 1 / (mean length of a burst)


NO_LOSS: Final = Loss(0.0, 0.0)


class LossEstimate:
    """The receiver's running estimate, from the number of the first datagram of a session."""

    def __init__(self, first: int) -> None:
        self._newest = first
        self._arrived = _ALL_ARRIVED  # bit i: the datagram i below the newest has arrived
        self._count = ASSUMED_ARRIVED
        self._lost = 0.0
        self._before_next = ASSUMED_LOST
        self._lost_again = 0.5 * ASSUMED_LOST
        self._was_lost = False

    def arrived(self, sequence: int, *, is_new: bool = False) -> None:
        """Record the first arrival of an accepted sequence number."""
        ahead = distance(sequence, self._newest)
        if is_new and ahead <= 0:  # the newest was wrong
            self._newest, self._arrived = sequence, _ALL_ARRIVED
            return
        if ahead <= 0:
            if -ahead < REORDERED:
                self._arrived |= 1 << -ahead
            return
        self._newest = sequence
        for step in range(min(ahead, MEMORY), 0, -1):
            self._add(lost=not self._arrived >> REORDERED - 1)
            self._arrived = (self._arrived << 1 | (step == 1)) & _ALL_ARRIVED

    def estimate(self) -> Loss | None:
        """Return the loss in whole per cents; None if it rounds to none."""
        share = round(REPORT_STEPS * self._lost / self._count)
        if not share:
            return None
        again = self._lost_again / self._before_next
        return Loss(share / REPORT_STEPS, round(REPORT_STEPS * again) / REPORT_STEPS)

    def _add(self, *, lost: bool) -> None:
        """Add the fate of the next datagram in order of sequence."""
        keep = 1.0 - 1.0 / MEMORY
        self._count = self._count * keep + 1.0
        self._lost = self._lost * keep + lost
        if self._was_lost:
            keep = 1.0 - 1.0 / REMEMBERED_LOSSES
            self._before_next = self._before_next * keep + 1.0
            self._lost_again = self._lost_again * keep + lost
        self._was_lost = lost


_ALL_ARRIVED: Final = (1 << REORDERED) - 1


def datagrams_needed(loss: Loss, window_us: float, silences_per_s: float) -> int:
    """Return how many evenly spaced datagrams a window needs, so that all of them are lost no more often than that.

    A run of losses begins at a datagram with probability share · (1 - again), and takes n datagrams or more with
    probability again^(n - 1).
    """
    share, again = loss
    starts_per_s = share * (1.0 - again) * 1e6 / window_us
    for datagrams in range(1, MOST_DATAGRAMS):
        if datagrams * starts_per_s * again ** float(datagrams - 1) <= silences_per_s:
            return datagrams
    return MOST_DATAGRAMS


MEDIAN_OF: Final = 9  # round trips whose median counts: a lasting change is followed after five of them
LONGEST_ROUND_TRIP_US: Final = 1_000_000  # an answer that no position has named after that is not timed any more


class RoundTrip:
    """The time from an answer to the first position that names it, which is when the master applies it.

    One answer at a time is timed. If a later one is named first, it was lost or overtaken, and says nothing.
    """

    def __init__(self) -> None:
        self.us = 0  # 0 before the first
        self._timed: tuple[int, int] | None = None  # number of the answer that is timed, and when it was sent [µs]
        self._newest_us: deque[int] = deque(maxlen=MEDIAN_OF)

    def sent(self, sequence: int, now_us: int) -> None:
        """Time an answer, unless another one is."""
        if self._timed is None or not 0 <= now_us - self._timed[1] < LONGEST_ROUND_TRIP_US:
            self._timed = sequence, now_us

    def named(self, sequence: int, now_us: int) -> None:
        """Note which answer a position names."""
        timed = self._timed
        if timed is None or distance(sequence, timed[0]) < 0:
            return
        if sequence == timed[0] and now_us >= timed[1]:
            self._newest_us.append(now_us - timed[1])
            self.us = sorted(self._newest_us)[len(self._newest_us) // 2]
        self._timed = None


@dataclass(slots=True)
class Traffic:
    """Datagrams of one direction."""

    packets: int = 0  # datagrams and their bytes, UDP and IP headers not included
    payload_bytes: int = 0
    by_kind: list[int] = field(default_factory=lambda: [0] * (max(Kind) + 1))  # by number of the kind
    late: int = 0  # older than the newest; dropped, except a FORCE that only KEEPALIVEs overtook
    duplicate: int = 0
    malformed: int = 0  # outside the protocol, or with invalid contents
    stray: int = 0  # well formed, but for no present session, or with a sequence number that is not accepted
    too_old: int = 0  # answers to a position beyond the largest age, or never sent; not applied
    over_rate: int = 0  # positions beyond the granted rate; not served
    lost_before: int = 0  # datagrams lost in sessions that have ended
    window: ArrivalWindow | None = None

    def add(self, kind: Kind, size: int) -> None:
        """Count one well-formed datagram of `size` bytes."""
        self.packets += 1
        self.payload_bytes += size
        self.by_kind[kind] += 1

    def add_malformed(self, size: int) -> None:
        """Count one malformed datagram of `size` bytes."""
        self.packets += 1
        self.payload_bytes += size
        self.malformed += 1

    def absorb(self, other: "Traffic") -> None:
        """Add the counts of another account, except arrivals."""
        self.packets += other.packets
        self.payload_bytes += other.payload_bytes
        self.by_kind = [ours + theirs for ours, theirs in zip(self.by_kind, other.by_kind, strict=True)]
        self.malformed += other.malformed
        self.stray += other.stray
        self.over_rate += other.over_rate

    def open_window(self, first: int, *, authentic: bool) -> None:
        """Start with the numbers of a new session from `first`; `authentic`: whether a seal proves them."""
        self.lost_before = self.lost
        self.window = ArrivalWindow(first, authentic=authentic)

    def arrive(self, sequence: int) -> Arrival:
        """Record a sequence number and return the kind of arrival."""
        assert self.window is not None, "no session is open"  # noqa: S101 - the caller's fault, not the peer's
        arrival = self.window.arrive(sequence)
        if arrival is _NEW:
            return arrival
        if arrival is Arrival.LATE:
            self.late += 1
        elif arrival is Arrival.DUPLICATE:
            self.duplicate += 1
        elif arrival is Arrival.ASTRAY:
            self.stray += 1
        return arrival

    @property
    def lost(self) -> int:
        """Datagrams that did not arrive, over all sessions."""
        return self.lost_before + (self.window.lost if self.window else 0)

    @property
    def wire_bytes(self) -> int:
        """Bytes with UDP and IPv4 headers."""
        return self.payload_bytes + self.packets * UDP_IPV4_HEADER_BYTES

    def report(self) -> dict[str, object]:
        """Return the report for JSON. For an outgoing direction, arrivals are unknown."""
        account: dict[str, object] = {
            "packets": self.packets,
            "payload_bytes": self.payload_bytes,
            "wire_bytes": self.wire_bytes,
            "by_kind": {kind.name.lower(): self.by_kind[kind] for kind in Kind if self.by_kind[kind]},
        }
        if self.window or self.malformed or self.stray:
            names = "lost", "late", "duplicate", "malformed", "stray", "too_old", "over_rate"
            account |= {name: getattr(self, name) for name in names}
        return account


class Distribution:
    """Durations [µs] in buckets one per cent wide: percentiles in constant memory."""

    RATIO: Final = 1.01

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._scale = 1.0 / math.log(self.RATIO)
        self.count = 0
        self.largest = 0.0

    def add(self, value_us: float) -> None:
        """Add a duration; a negative one, caused only by a clock that went back, counts as zero."""
        bucket = int(math.log(value_us) * self._scale) if value_us > 1.0 else 0
        counts = self._counts
        counts[bucket] = counts.get(bucket, 0) + 1
        self.count += 1
        if value_us > self.largest:
            self.largest = value_us

    def absorb(self, counts: Mapping[int, int]) -> None:
        """Add durations that were counted elsewhere; the largest is then known to within one per cent."""
        for bucket, count in counts.items():
            self._counts[bucket] = self._counts.get(bucket, 0) + count
            self.count += count
            self.largest = max(self.largest, self.RATIO ** (bucket + 1))

    def percentile(self, percent: float) -> float | None:
        """Return the upper edge [µs] of the bucket that holds the percentile; None if nothing was added."""
        rank = percent / 100.0 * self.count
        seen = 0
        for bucket in sorted(self._counts):
            seen += self._counts[bucket]
            if seen >= rank:
                return float(min(self.RATIO ** (bucket + 1), self.largest))
        return None

    def counts(self) -> dict[int, int]:
        """Return how many durations fell into each bucket; bucket b ends at `RATIO`^(b + 1) µs."""
        return self._counts

    def report(self) -> dict[str, object]:
        """Return count, percentiles and maximum [µs] for JSON; None if nothing was measured."""
        return {
            "count": self.count,
            "p50_us": self.percentile(50),
            "p99_us": self.percentile(99),
            "p99_9_us": self.percentile(99.9),
            "max_us": self.largest if self.count else None,
        }
