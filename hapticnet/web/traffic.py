"""Packets and bytes of both directions compared with no compression, and round trips."""

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hapticnet.node.master import MasterNode
from hapticnet.node.offline import force_datagram_bytes
from hapticnet.protocol.seal import TAG_BYTES
from hapticnet.protocol.stats import Distribution
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, Kind

WINDOW_S: Final = 1.0
_Counts = tuple[float, ...]  # packets, wire bytes, and both if every sample were sent raw; feedback, then forward
_KEYS: Final = ("packets", "bytes", "raw_packets", "raw_bytes")


def raw_wire_bytes(sequence: int, axes: int, *, sealed: bool) -> int:
    """Return the bytes of a datagram with an uncompressed force, with headers."""
    one = np.array([sequence]), np.array([1 << 31]), np.array([4 * axes], dtype=np.uint16)  # of a time only the size
    return int(force_datagram_bytes(*one)[0]) + (TAG_BYTES if sealed else 0) + UDP_IPV4_HEADER_BYTES


class RecentMedian:
    """Median of a distribution's samples of the last second, which soon shows a change of the delay."""

    def __init__(self) -> None:
        self._past: deque[tuple[float, dict[int, int]]] = deque([(0.0, {})])

    def of(self, distribution: Distribution, now_s: float) -> float | None:
        """Return it in µs, or None if nothing was added; call this a few times a second."""
        past, counts = self._past, dict(distribution.counts())
        past.append((now_s, counts))
        while len(past) > 2 and now_s - past[1][0] >= WINDOW_S:
            past.popleft()
        before = past[0][1]
        gained = {bucket: count - before.get(bucket, 0) for bucket, count in counts.items()}
        half, seen = sum(gained.values()) / 2, 0
        for bucket in sorted(gained):
            seen += gained[bucket]
            if seen >= half > 0:
                return float(distribution.RATIO ** (bucket + 1))
        return None


class TrafficMeter:
    """Rates over the last second, and totals of times with a force since the settings last changed."""

    def __init__(self, node: MasterNode) -> None:
        self.since_s = 0.0  # when the totals began [s]
        self._node = node
        self._raw_positions = 0
        self._raw_bytes = 0
        self._last = self._count()
        self._totals: _Counts = (0.0,) * len(self._last)
        self._arrived_before = self._lost_before = 0
        self._past: deque[tuple[float, _Counts]] = deque([(0.0, self._last)])

    def restart(self, now_s: float) -> None:
        """Begin the totals again."""
        self.since_s = now_s
        self._last = self._count()
        self._totals = (0.0,) * len(self._last)
        self._arrived_before = self._node.session.received.packets
        self._lost_before = self._node.session.received.lost

    @property
    def arrived(self) -> int:
        """Datagrams of the slave that arrived since `since_s`."""
        return self._node.session.received.packets - self._arrived_before

    @property
    def lost(self) -> int:
        """Datagrams of the slave that did not arrive since `since_s`."""
        # A datagram that was only late is subtracted again, perhaps after the totals began.
        return max(0, self._node.session.received.lost - self._lost_before)

    def report(self, now_s: float, *, felt: bool) -> dict[str, dict[str, float]]:
        """Return both directions for the state message; `felt`: whether a force was felt since the last call."""
        counts = self._count()
        if felt:
            gained = zip(self._totals, counts, self._last, strict=True)
            self._totals = tuple(total + new - old for total, new, old in gained)
        self._last = counts
        past = self._past
        past.append((now_s, counts))
        while len(past) > 2 and now_s - past[1][0] >= WINDOW_S:
            past.popleft()
        then_s, before = past[0]
        elapsed_s = max(now_s - then_s, 0.2)
        rates = [(new - old) / elapsed_s for new, old in zip(counts, before, strict=True)]
        totals = self._totals
        return {"feedback": _direction(rates[:4], totals[:4]), "forward": _direction(rates[4:], totals[4:])}

    def _count(self) -> _Counts:
        session, axes = self._node.session, self._node.axes
        positions = session.sent.by_kind[Kind.POSITION]
        new = positions - self._raw_positions
        self._raw_positions = positions
        self._raw_bytes += max(new, 0) * raw_wire_bytes(positions, axes, sealed=session.sealed)
        sent = session.sent.packets, session.sent.wire_bytes
        back, drawing = session.received, session.drawing
        packets, wire_bytes = back.packets - drawing.packets, back.wire_bytes - drawing.wire_bytes
        return (packets, wire_bytes, positions, self._raw_bytes, *sent, *sent)


def _direction(rates: Sequence[float], totals: Sequence[float]) -> dict[str, Any]:
    return {f"{key}_per_s": round(rate, 1) for key, rate in zip(_KEYS, rates, strict=True)} | {
        key: int(total) for key, total in zip(_KEYS, totals, strict=True)
    }
