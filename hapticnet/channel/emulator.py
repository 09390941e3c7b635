"""The channel emulator: packets enter with the time they are sent and leave when they are due."""

import heapq
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np

from hapticnet.channel.settings import BernoulliLoss, ChannelSettings

T = TypeVar("T")

HEADER_BYTES: Final = 20 + 8  # bytes of each packet's IPv4 header without options (RFC 791) and UDP header (RFC 768)

MAX_IN_FLIGHT: Final = 100_000
"""Limit of packets in an emulator, so that memory stays bounded if packets are never taken out."""

_COUNTED: Final = ("accepted", "delivered", "lost", "queue_dropped", "duplicated")
_NS_PER_US: Final = 1_000
_NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelCounters:
    """Counters of packets: accepted + duplicated = delivered + lost + queue_dropped + in flight."""

    accepted: int
    delivered: int  # packets taken out, duplicates included
    lost: int  # packets dropped by the loss model
    # Packets dropped because the bottleneck's queue was full or `MAX_IN_FLIGHT` packets were in flight
    queue_dropped: int
    duplicated: int
    reordered: int  # packets delivered after one that was pushed in later (RFC 4737, section 3)
    # The same in bytes on the wire, UDP and IPv4 headers included
    accepted_bytes: int
    delivered_bytes: int
    lost_bytes: int
    queue_dropped_bytes: int
    duplicated_bytes: int


class Emulator(Generic[T]):
    """One direction of an emulated network.

    The fate of a packet depends only on the seed, the settings, its size and the packets pushed before it, not on when
    `due` is called. Each random effect has its own stream, so the same packets are lost whatever the jitter is. A time
    stamp earlier than the previous one is kept: the packet still waits for those it must not overtake, and for
    a busy bottleneck. Child streams are spawned from `rng`; nothing is drawn from it.
    """

    __slots__ = (
        "_accepted", "_accepted_bytes", "_delay_us", "_delivered", "_delivered_bytes", "_duplicated",
        "_duplicated_bytes", "_duplicates", "_fifo", "_heap", "_hold_back_us", "_hold_backs", "_jitter_us",
        "_last_due_us", "_link_free_ns", "_losses", "_lost", "_lost_bytes", "_newest_delivered",
        "_plain", "_queue_dropped", "_queue_dropped_bytes", "_queue_ns", "_rate_bit_per_s", "_reordered", "_reorders",
        "_rngs", "settings",
    )  # fmt: skip

    def __init__(self, settings: ChannelSettings, rng: np.random.Generator) -> None:
        self._rngs = rng.spawn(4)
        self._link_free_ns = 0
        # Packets in flight are in one of these. The queue is used if packets keep their order: each waits for the one
        # before it. Otherwise the heap holds (due, number, copy, item, size), so that no two entries compare equal
        # before their items.
        self._fifo: deque[tuple[int, T, int]] = deque()
        self._heap: list[tuple[int, int, bool, T, int]] = []
        self._reorders = False
        self._last_due_us = 0
        self._newest_delivered = 0

        self._accepted = self._accepted_bytes = 0
        self._delivered = self._delivered_bytes = 0
        self._lost = self._lost_bytes = 0
        self._queue_dropped = self._queue_dropped_bytes = 0
        self._duplicated = self._duplicated_bytes = 0
        self._reordered = 0
        self.change(settings)

    def change(self, settings: ChannelSettings) -> None:
        """Use other settings for the packets pushed from now on; those in flight arrive as planned."""
        self.settings = settings
        loss_rng, duplicate_rng, jitter_rng, reorder_rng = self._rngs
        loss, jitter = settings.loss, settings.jitter
        self._losses = loss.fates(loss_rng) if loss is not None and loss.mean > 0.0 else None
        self._duplicates = _chances(settings.duplicate_probability, duplicate_rng)
        self._hold_backs = _chances(settings.reorder_probability, reorder_rng)
        self._hold_back_us = settings.hold_back_us
        self._jitter_us = jitter.delays_us(jitter_rng) if jitter is not None and jitter.deviation_us else None
        self._delay_us = settings.delay_us
        self._rate_bit_per_s = settings.rate_bit_per_s
        self._queue_ns = settings.queue_us * _NS_PER_US
        if self._hold_backs is not None and not self._reorders:  # from now on the heap is used
            self._reorders = True
            oldest = self._accepted - len(self._fifo) + 1
            self._heap = [(due, oldest + n, False, item, size) for n, (due, item, size) in enumerate(self._fifo)]
            self._last_due_us = max((due for due, _, _ in self._fifo), default=0)
            self._fifo.clear()
            heapq.heapify(self._heap)
        self._plain = not self._reorders and all(
            part is None for part in (self._losses, self._duplicates, self._jitter_us, self._rate_bit_per_s)
        )

    @property
    def in_flight(self) -> int:
        """Number of packets pushed and neither delivered nor dropped, copies included."""
        return len(self._fifo) + len(self._heap)

    @property
    def counters(self) -> ChannelCounters:
        """Counters of packets so far."""
        counts = {name: getattr(self, f"_{name}") for name in _COUNTED}
        sizes = {
            f"{name}_bytes": getattr(self, f"_{name}_bytes") + HEADER_BYTES * count for name, count in counts.items()
        }
        return ChannelCounters(reordered=self._reordered, **counts, **sizes)

    def push(self, item: T, size_bytes: int, now_us: int) -> None:
        """Send a packet with a UDP payload of this many bytes at a time [µs]; `due` returns the item."""
        self._accepted += 1
        self._accepted_bytes += size_bytes
        if self._plain:
            fifo = self._fifo
            if len(fifo) >= MAX_IN_FLIGHT:
                self._drop(size_bytes)
            else:
                fifo.append((now_us + self._delay_us, item, size_bytes))
            return
        if self._losses is not None and next(self._losses):
            self._lost += 1
            self._lost_bytes += size_bytes
            return
        self._forward(item, size_bytes, now_us, is_copy=False)
        if self._duplicates is not None and next(self._duplicates):
            self._duplicated += 1
            self._duplicated_bytes += size_bytes
            self._forward(item, size_bytes, now_us, is_copy=True)

    def due(self, now_us: int) -> list[T]:
        """Remove and return the packets due by `now_us` [µs], in order of delivery."""
        under_way = self._heap or self._fifo
        if not under_way or under_way[0][0] > now_us:
            return []
        items: list[T] = []
        if self._reorders:
            heap = self._heap
            while heap and heap[0][0] <= now_us:
                _, number, _, item, size_bytes = heapq.heappop(heap)
                items.append(item)
                self._delivered_bytes += size_bytes
                if number < self._newest_delivered:
                    self._reordered += 1
                else:
                    self._newest_delivered = number
        else:
            fifo = self._fifo
            while fifo and fifo[0][0] <= now_us:
                _, item, size_bytes = fifo.popleft()
                items.append(item)
                self._delivered_bytes += size_bytes
        self._delivered += len(items)
        return items

    def next_timer_us(self) -> int | None:
        """Return the time [µs] when the next packet is due, or None if none is in flight."""
        if self._fifo:
            return self._fifo[0][0]
        return self._heap[0][0] if self._heap else None

    def _forward(self, item: T, size_bytes: int, now_us: int, *, is_copy: bool) -> None:
        """Send a packet or a copy through the bottleneck and the delay."""
        under_way = self._heap or self._fifo
        if len(under_way) >= MAX_IN_FLIGHT:
            self._drop(size_bytes)
            return
        if self._rate_bit_per_s is not None:
            # Whole nanoseconds, rounded up: exact at any time stamp, and never faster than the rate.
            start_ns = max(now_us * _NS_PER_US, self._link_free_ns)
            if start_ns - now_us * _NS_PER_US > self._queue_ns:
                self._drop(size_bytes)
                return
            bits = (size_bytes + HEADER_BYTES) * 8
            self._link_free_ns = start_ns - -bits * _NS_PER_S // self._rate_bit_per_s
            now_us = -(-self._link_free_ns // _NS_PER_US)
        due_us = now_us + self._delay_us
        if self._jitter_us is not None:
            due_us += next(self._jitter_us)
        if not self._reorders:
            self._fifo.append((due_us, item, size_bytes))
            return
        if under_way and due_us < self._last_due_us:
            due_us = self._last_due_us
        if self._hold_backs is not None and next(self._hold_backs):
            due_us += self._hold_back_us
        else:
            self._last_due_us = due_us
        heapq.heappush(self._heap, (due_us, self._accepted, is_copy, item, size_bytes))

    def _drop(self, size_bytes: int) -> None:
        self._queue_dropped += 1
        self._queue_dropped_bytes += size_bytes


def _chances(probability: float, rng: np.random.Generator) -> Iterator[bool] | None:
    return BernoulliLoss(probability).fates(rng) if probability > 0.0 else None
