"""When an update is believed lost, so that the current stimulus is sent in its place."""

from typing import Final

from hapticnet.protocol.serial_number import distance

INITIAL_TIMEOUT_US: Final = 100_000
SHORTEST_TIMEOUT_US: Final = 5_000
LONGEST_TIMEOUT_US: Final = 1_000_000


class Repair:
    """Watches the newest FORCE until a POSITION acknowledges it.

    Only the newest matters: a FORCE carries the whole stimulus, so any later one makes up for all before it. The
    timeout is that of RFC 6298 (smoothed round trip plus four mean deviations, doubled at each expiry) with bounds
    that fit a stream which is acknowledged a thousand times a second.
    """

    __slots__ = ("_deviation_us", "_newest", "_sent_us", "_smoothed_us", "_timeout_us")

    def __init__(self) -> None:
        self._newest: int | None = None
        self._sent_us = 0
        self._smoothed_us: float | None = None
        self._deviation_us = 0.0
        self._timeout_us = float(INITIAL_TIMEOUT_US)

    def sent(self, sequence: int, now_us: int) -> None:
        """Take note that FORCE `sequence` was sent."""
        self._newest = sequence
        self._sent_us = now_us

    def acknowledged(self, sequence: int, now_us: int) -> None:
        """Take note that the master has applied FORCE `sequence`."""
        if self._newest is None or distance(sequence, self._newest) < 0:
            return
        self._newest = None
        round_trip_us = max(0, now_us - self._sent_us)
        if self._smoothed_us is None:
            self._smoothed_us, self._deviation_us = round_trip_us, round_trip_us / 2
        else:
            self._deviation_us += (abs(round_trip_us - self._smoothed_us) - self._deviation_us) / 4
            self._smoothed_us += (round_trip_us - self._smoothed_us) / 8
        self._timeout_us = max(SHORTEST_TIMEOUT_US, self._smoothed_us + 4 * self._deviation_us)

    def expire(self, now_us: int) -> bool:
        """Tell whether the newest update must be replaced now; each time it must, the timeout doubles."""
        # A clock that went back tells nothing of how long it has been: better once too often.
        if self._newest is None or 0 <= now_us - self._sent_us <= self._timeout_us:
            return False
        self._timeout_us = min(2 * self._timeout_us, LONGEST_TIMEOUT_US)
        return True
