"""Counters of datagrams and bytes per direction, and distributions in constant memory."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from hapticnet.protocol.arrivals import Arrival, ArrivalWindow
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind


@dataclass(slots=True)
class Traffic:
    """Datagrams of one direction.

    Attributes
    ----------
    packets, payload_bytes
        Datagrams and their bytes, UDP and IP headers not included.
    by_kind
        Datagrams of each kind, by the kind's number (hashing an enum costs more than the rest of the count).
    late, duplicate
        Older than the newest one seen; seen before. Both are dropped, except a FORCE that only KEEPALIVEs overtook.
    malformed
        Not of the protocol, or with invalid contents.
    stray
        Well formed, but of no present session, or with a sequence number that is not believed.
    too_old
        Forces and keepalives that answer a position beyond the largest age, or one that was never sent; not applied.
    over_rate
        Positions beyond the granted rate; not served.
    lost_before
        Datagrams lost in sessions that have ended.
    """

    packets: int = 0
    payload_bytes: int = 0
    by_kind: list[int] = field(default_factory=lambda: [0] * (max(Kind) + 1))
    late: int = 0
    duplicate: int = 0
    malformed: int = 0
    stray: int = 0
    too_old: int = 0
    over_rate: int = 0
    lost_before: int = 0
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
        """Add the counts of another account, except those of arrivals."""
        self.packets += other.packets
        self.payload_bytes += other.payload_bytes
        self.by_kind = [ours + theirs for ours, theirs in zip(self.by_kind, other.by_kind, strict=True)]
        self.malformed += other.malformed
        self.stray += other.stray
        self.over_rate += other.over_rate

    def open_window(self, first: int, *, authentic: bool) -> None:
        """Start with the sequence numbers of a new session, whose first datagram was `first`.

        `authentic`: whether a seal proves the numbers.
        """
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
        """Return the account for JSON. For a direction that is only sent, arrivals are unknown."""
        account: dict[str, object] = {
            "packets": self.packets,
            "payload_bytes": self.payload_bytes,
            "wire_bytes": self.wire_bytes,
            "by_kind": {kind.name.lower(): self.by_kind[kind] for kind in Kind if self.by_kind[kind]},
        }
        if self.window or self.malformed or self.stray:
            account |= {
                "lost": self.lost,
                "late": self.late,
                "duplicate": self.duplicate,
                "malformed": self.malformed,
                "stray": self.stray,
                "too_old": self.too_old,
                "over_rate": self.over_rate,
            }
        return account


_NEW: Final = Arrival.NEW


class Distribution:
    """Durations [µs] in buckets one per cent wide: percentiles in constant memory."""

    RATIO: Final = 1.01
    __slots__ = ("_counts", "_scale", "count", "largest")

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._scale = 1.0 / math.log(self.RATIO)
        self.count = 0
        self.largest = 0.0

    def add(self, value_us: float) -> None:
        """Add a duration; a negative one, which only a clock that went back causes, counts as zero."""
        bucket = int(math.log(value_us) * self._scale) if value_us > 1.0 else 0
        counts = self._counts
        counts[bucket] = counts.get(bucket, 0) + 1
        self.count += 1
        if value_us > self.largest:
            self.largest = value_us

    def absorb(self, counts: Mapping[int, int]) -> None:
        """Add durations that were counted elsewhere; the largest is then known to one per cent."""
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
