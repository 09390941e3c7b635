"""Whether an answer of the slave is fresh, by the master's own clock, and how long ago the last fresh one came."""

from typing import Final

from hapticnet.protocol.serial_number import unwrap


class Freshness:
    """Judge answers by the time stamp of the position that they answer.

    The slave echoes time stamps of the master, so no clock but the master's counts. An answer is fresh if its position
    is at most `max_age_us` old and was sent at all.

    Attributes
    ----------
    newest_t_us
        Time [µs] of the newest position that was sent.
    ahead_us
        How long [µs] after a position the slave may answer for: it goes on along a line.
    heard_us
        When the last fresh answer arrived that is newer than all before it.
    too_old_us
        Age of the least old answer since then that was too old; None if there was none.
    too_old_at_us
        When the last such answer arrived.
    """

    __slots__ = ("_max_age_us", "ahead_us", "heard_us", "newest_t_us", "too_old_at_us", "too_old_us")

    def __init__(self, max_age_us: int) -> None:
        self.heard_us = 0
        self.too_old_us: int | None = None
        self.too_old_at_us: int | None = None
        self._max_age_us = max_age_us
        self.newest_t_us = 0
        self.ahead_us = 0

    def fresh_t_us(self, echoed_t_us: int, now_us: int, *, is_new: bool) -> int | None:
        """Return the unwrapped time [µs] of the position that is answered; None if the answer is not fresh.

        `is_new` tells whether the answer is newer than all before it. Copies of old answers say nothing about the link.
        """
        t_us = unwrap(echoed_t_us, now_us)
        if t_us > self.newest_t_us and t_us > min(self.newest_t_us + self.ahead_us, now_us):
            return None  # no such position was sent
        age_us = now_us - t_us
        # The position behind an answer may be older than the time that it is for.
        if age_us <= self._max_age_us - self.ahead_us:
            return t_us
        if is_new:
            self.too_old_us = age_us if self.too_old_us is None else min(age_us, self.too_old_us)
            self.too_old_at_us = now_us
        return None

    def heard(self, now_us: int) -> None:
        """Note a fresh answer that is newer than all before it, or a new session."""
        self.heard_us = now_us
        self.too_old_us = self.too_old_at_us = None

    def is_slow(self, within_us: int, now_us: int) -> bool:
        """Return whether the link works, but too slowly: an answer that was too old arrived within `within_us`."""
        return self.too_old_at_us is not None and 0 <= now_us - self.too_old_at_us <= within_us

    def silent_us(self, now_us: int) -> int:
        """Return how long [µs] nothing fresh has arrived."""
        self.heard_us = min(self.heard_us, now_us)  # a clock that went back must not shorten a silence
        return now_us - self.heard_us


STALE_GROWTH: Final = 1.25
"""By how much each interval between positions is longer than the last while the link is stale."""


class Pace:
    """Positions ever less often while the link is stale, from 1 ms apart to `slowest_us`, so that it can recover."""

    __slots__ = ("_interval_us", "_next_us", "_slowest_us")

    def __init__(self, slowest_us: int) -> None:
        self._slowest_us = slowest_us
        self._interval_us = 0.0
        self._next_us = 0

    def begin(self, now_us: int) -> None:
        """Begin, because the link is stale from now on."""
        self._interval_us = 1000.0
        self._next_us = now_us

    def is_due(self, now_us: int) -> bool:
        """Return whether a position is due, and count it as sent."""
        if 0 < self._next_us - now_us <= self._slowest_us:
            return False
        self._interval_us = min(STALE_GROWTH * self._interval_us, self._slowest_us)
        self._next_us = now_us + round(self._interval_us)
        return True
