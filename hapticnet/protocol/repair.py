"""When an update is believed lost, so that the current stimulus is sent in its place."""

from collections import deque
from typing import Final

from hapticnet.protocol.serial_number import distance

INITIAL_TIMEOUT_US: Final = 100_000
SHORTEST_TIMEOUT_US: Final = 5_000
LONGEST_TIMEOUT_US: Final = 1_000_000

GRANULARITY_US: Final = 5_000
"""Least that the timeout is above the smoothed round trip: G of RFC 6298. Acknowledgements come with positions, so they
jitter by a sampling period even where the network does not."""

MOST_REMEMBERED: Final = 1024
"""Unacknowledged updates whose time of sending is remembered, for the round trip: a second at 1 kHz."""


class Repair:
    """Times the oldest FORCE that no POSITION has acknowledged yet.

    An acknowledgement covers every FORCE up to the one it names, because a master acknowledges only what it applied.
    The oldest counts, not the newest: a FORCE may build on earlier ones, so while one is missing the master refuses
    those after it, and a timer that every new FORCE restarts would never expire. When the timeout expires, the current
    stimulus is sent, and the timer starts again from there. From then until a FORCE sent since is acknowledged, no
    FORCE may build on earlier ones, so that the first to arrive ends the loss.

    The timeout is that of RFC 6298: smoothed round trip plus four mean deviations, doubled at each expiry, within
    bounds that suit a stream that is acknowledged a thousand times a second.

    Attributes
    ----------
    recovering
        Whether FORCEs must need no earlier one.
    """

    __slots__ = ("_deviation_us", "_expired_us", "_sent", "_since_us", "_smoothed_us", "_timeout_us", "recovering")

    def __init__(self) -> None:
        self.recovering = False
        self._sent: deque[tuple[int, int]] = deque(maxlen=MOST_REMEMBERED)  # sequence and time, oldest first
        self._since_us = 0  # since when the oldest of them is waited for
        self._expired_us = 0
        self._smoothed_us: float | None = None
        self._deviation_us = 0.0
        self._timeout_us = float(INITIAL_TIMEOUT_US)

    def sent(self, sequence: int, now_us: int) -> None:
        """Record that FORCE `sequence` was sent."""
        if not self._sent:
            self._since_us = now_us
        self._sent.append((sequence, now_us))

    def acknowledged(self, sequence: int, now_us: int) -> None:
        """Record that the master has applied FORCE `sequence`; a number that was never sent is ignored."""
        sent = self._sent
        if not sent or distance(sequence, sent[0][0]) < 0 or distance(sequence, sent[-1][0]) > 0:
            return
        sent_us = now_us
        while sent and distance(sequence, sent[0][0]) >= 0:
            _, sent_us = sent.popleft()
        if sent:
            self._since_us = max(self._since_us, sent[0][1])
        if sent_us >= self._expired_us:
            self.recovering = False
        self._measure(max(0, now_us - sent_us))

    def expire(self, now_us: int) -> bool:
        """Return whether the current stimulus must be sent now; each time it must, the timeout doubles."""
        # A clock that went back does not tell how long it has been: better once too often.
        if not self._sent or 0 <= now_us - self._since_us <= self._timeout_us:
            return False
        self._since_us = self._expired_us = now_us
        self.recovering = True
        self._timeout_us = max(self._timeout_us, min(2 * self._timeout_us, LONGEST_TIMEOUT_US))
        return True

    def _measure(self, round_trip_us: int) -> None:
        if self._smoothed_us is None:
            self._smoothed_us, self._deviation_us = round_trip_us, round_trip_us / 2
        else:
            self._deviation_us += (abs(round_trip_us - self._smoothed_us) - self._deviation_us) / 4
            self._smoothed_us += (round_trip_us - self._smoothed_us) / 8
        margin_us = max(GRANULARITY_US, 4 * self._deviation_us)
        self._timeout_us = max(SHORTEST_TIMEOUT_US, self._smoothed_us + margin_us)
