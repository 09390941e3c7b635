"""Decide when the slave sends although the codec does not.

This is when an update is or may be lost, or silence would look like a dead link. There are three ways, all with the
*present* stimulus in an update that decodes on its own:

- Replace: an update whose acknowledgement is overdue is lost. This takes a round trip.
- Repeat: while the master reports loss, the present stimulus is repeated soon after an update, while the
  probability that the master holds a perceptibly different one is too high.
- Pace: while the master reports loss, the longest silence is shortened until a run of losses hardly ever lasts as long
  as the master waits before it releases the force.

Without reported loss only the first is active, and costs nothing unless an update is lost.
"""

import math
from collections import deque
from typing import Final, NamedTuple

from hapticnet.parts import apart_function
from hapticnet.perception import WeberLaw
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.stats import NO_LOSS, Loss, datagrams_needed
from hapticnet.protocol.wire import distance
from hapticnet.samples import Vector

INITIAL_TIMEOUT_US: Final = 100_000
SHORTEST_TIMEOUT_US: Final = 5_000
LONGEST_TIMEOUT_US: Final = 1_000_000

GRANULARITY_US: Final = 5_000
"""Least excess of the timeout over the smoothed round trip: G of RFC 6298. Positions carry acknowledgements, so they
jitter by a sampling period even where the network does not."""

MOST_REMEMBERED: Final = 1024  # most unacknowledged datagrams that are remembered: a second at 1 kHz
REPORT_LASTS_US: Final = 1_000_000  # validity of a report of loss. A master without loss sends none.
MOST_CREDIT: Final = 24.0  # most repeats that can be saved up: those of 200 ms at 1 kHz
PACE_STEP_US: Final = 500
SCHEDULING_US: Final = 5_000
"""Part of the master's age limit reserved for the spacing of positions and ticks."""


class Sent(NamedTuple):
    """A datagram without acknowledgement, and the stimulus held if it is lost; None if its loss does no harm."""

    sequence: int
    sent_us: int
    before: Vector | None


class Repair:
    """Decides when the present stimulus must be sent.

    An acknowledgement covers every datagram up to the one it names, because a master acknowledges only what it applied
    or confirmed. The oldest one without acknowledgement counts, not the newest: a FORCE may build on earlier ones, so
    while one is missing the master refuses those after it, and a timer that every new FORCE restarts would never
    expire. The timeout follows RFC 6298: smoothed round trip plus four mean deviations, doubled at each expiry,
    within bounds that suit a stream acknowledged a thousand times a second.

    `law`: the law of the person at the master.
    `sparse`: whether positions are sent only when they matter, and acknowledgements with them.
    """

    def __init__(self, settings: SessionSettings, law: WeberLaw, now_us: int, *, sparse: bool = False) -> None:
        self._idle_us = settings.idle_keepalive_us if sparse else None  # while no force is felt
        self._ack_delay_us = settings.ack_delay_us if sparse else 0
        self._longest_us = settings.sparse_keepalive_us if sparse else settings.keepalive_us
        self.keepalive_us = self._longest_us  # the longest silence at present [µs]
        self._settings = settings.repair
        self._apart = apart_function(law)
        self._age_limit_us = settings.stale_after_us  # silence after which the master releases the force
        self._recovering = False
        self._sent: deque[Sent] = deque(maxlen=MOST_REMEMBERED)  # oldest first
        self._since_us = 0  # start of the wait for the oldest
        self._expired_us = 0
        self._spoke_us = now_us
        self._smoothed_us: float | None = None
        self._deviation_us = 0.0
        self._overdue_us = float(INITIAL_TIMEOUT_US)  # age at which a datagram is known to be lost
        self._timeout_us = self._overdue_us
        self._loss = NO_LOSS
        self._reported_us = 0
        self._late_us = 0.0  # mean excess of the slave's silence over the longest silence
        self._needed = 1  # number of datagrams of which one must arrive within the age limit
        self._credit = MOST_CREDIT

    @property
    def complete(self) -> bool:
        """Whether every FORCE must decode on its own, so that the first to arrive ends a loss."""
        return self._recovering or self._loss.share > self._settings.complete_above

    @property
    def is_lossy(self) -> bool:
        """Whether the master reports loss."""
        return self._loss.share > 0.0

    def sent(self, sequence: int, now_us: int, before: Vector | None) -> None:
        """Record a FORCE; `before` is the stimulus held if it is lost, None if losing it does no harm."""
        if not self._sent:
            self._since_us = now_us
        self._sent.append(Sent(sequence, now_us, before))

    def kept_alive(self, sequence: int, now_us: int, held: Vector | None, *, tells: bool = False) -> None:
        """Record a KEEPALIVE, which confirms the held stimulus; awaited during loss, or if it carries news."""
        if tells or (self._settings.paces and self._loss.share):
            self.sent(sequence, now_us, held)

    def spoke(self, now_us: int) -> None:
        """Record that a datagram was sent, of any kind."""
        self._spoke_us = now_us

    def acknowledged(self, sequence: int, now_us: int) -> None:
        """Record that the master has applied or confirmed `sequence`; a number that was never sent is ignored."""
        sent = self._sent
        if not sent:
            return
        if sent[0].sequence == sequence:  # the common case, kept short: every force waits for this
            sent_us = sent.popleft().sent_us
        elif distance(sequence, sent[0].sequence) < 0 or distance(sequence, sent[-1].sequence) > 0:
            return
        else:
            while sent and distance(sequence, sent[0].sequence) >= 0:
                sent_us = sent.popleft().sent_us
        if sent:
            self._since_us = max(self._since_us, sent[0].sent_us)
        if sent_us >= self._expired_us:
            self._recovering = False
        self._measure(now_us - sent_us if now_us > sent_us else 0)

    def reported(self, loss: Loss, now_us: int) -> None:
        """Update the share of the slave's datagrams that the master misses."""
        self._reported_us = now_us
        if self._settings.repeats or self._settings.paces:
            self._loss = loss
            if self._settings.paces:
                self._pace()

    def is_due(self, now_us: int, stimulus: Vector) -> bool:
        """Return whether the present stimulus must be sent now. Call it once for each position that arrives."""
        if not self._sent:
            return False
        # If the clock went back, the elapsed time is unknown: better send once too often.
        if self._settings.replaces and not 0 <= now_us - self._since_us <= self._timeout_us:
            self._since_us = self._expired_us = now_us
            self._recovering = True
            self._timeout_us = max(self._timeout_us, min(2 * self._timeout_us, LONGEST_TIMEOUT_US))
            return True
        if not self._loss.share:
            return False
        if now_us - self._reported_us > REPORT_LASTS_US:
            self.reported(NO_LOSS, now_us)
            return False
        self._credit = min(self._credit + self._settings.repeats_per_position, MOST_CREDIT)
        silent_us = now_us - self._spoke_us
        if silent_us < self._settings.shortest_wait_us:
            return False
        # A FORCE instead of a KEEPALIVE costs a few bytes, and repairs the loss.
        if (
            self._keeps_alive(silent_us)
            or self._may_be_silent(now_us)
            or (self._settings.repeats and self._credit >= 1.0 and silent_us >= self._wait_us(stimulus))
        ):
            self._credit = max(self._credit - 1.0, 0.0)
            return True
        return False

    def spoke_lately(self, now_us: int) -> bool:
        """Return whether `keepalive_is_due` is False at any force."""
        return 0 <= now_us - self._spoke_us < self.keepalive_us

    def keepalive_is_due(self, now_us: int, *, idle: bool = False) -> bool:
        """Return whether nothing was sent for the longest silence; `idle`: while no force is felt."""
        silent_us = now_us - self._spoke_us
        if idle and self._idle_us is not None and not self._loss.share and 0 <= silent_us < self._idle_us:
            return False
        # A clock that went back must not silence the slave until it has caught up.
        return silent_us < 0 or self._keeps_alive(silent_us)

    def _keeps_alive(self, silent_us: int) -> bool:
        if silent_us < self.keepalive_us:
            return False
        # Datagrams are sent when positions arrive, and these arrive unevenly.
        late_us = min(silent_us - self.keepalive_us, self._longest_us)
        self._late_us += (late_us - self._late_us) / 32
        return True

    def _may_be_silent(self, now_us: int) -> bool:
        """Return whether a datagram is known to be lost, and too few were sent since to be sure that one arrived."""
        if not self._settings.paces or now_us - self._sent[0].sent_us <= self._overdue_us:
            return False
        for since, entry in enumerate(reversed(self._sent)):
            if since >= self._needed:
                return False
            if now_us - entry.sent_us > self._overdue_us:
                return True
        return False

    def _wait_us(self, x: Vector) -> float:
        """Return the wait [µs] after the newest datagram before repeating x; infinity if not needed.

        If the newest n datagrams are all lost, the master holds the stimulus from before the first of these.
        """
        share, again = self._loss
        limit = self._settings.doubt_limit
        all_lost, doubt, newest_miss, miss = share, 0.0, 0.0, 0.0
        for entry in reversed(self._sent):
            if doubt + all_lost <= limit:
                break
            miss = 0.0 if entry.before is None else self._apart(x, entry.before)
            if miss > 1.0:
                doubt += all_lost * (1.0 - again)
                newest_miss = newest_miss or miss
            all_lost *= again
        else:
            if miss > 1.0:  # nothing without acknowledgement has arrived
                doubt += all_lost
        if doubt <= limit:
            return math.inf
        return max(self._settings.shortest_wait_us, self._settings.longest_wait_us / newest_miss)

    def _pace(self) -> None:
        """Choose the longest silence: the largest that leaves enough chances for a datagram within the age limit."""
        self.keepalive_us, self._needed = self._longest_us, 1
        if not self._loss.share:
            return
        settings = self._settings
        window_us = max(self._age_limit_us - SCHEDULING_US - 4.0 * self._deviation_us, 0.5 * self._age_limit_us)
        self._needed = datagrams_needed(self._loss, window_us, settings.silences_per_s)
        while self.keepalive_us > settings.shortest_keepalive_us:
            spacing_us = self.keepalive_us + self._late_us
            chances = window_us / spacing_us
            left_us = window_us - spacing_us - self._overdue_us
            if left_us > 0.0:  # the first loss is noticed in time to send more often
                chances = 1.0 + self._overdue_us / spacing_us
                chances += left_us / (settings.shortest_wait_us + 2.0 * self._late_us)
            if chances >= self._needed:
                return
            self.keepalive_us -= PACE_STEP_US

    def _measure(self, round_trip_us: int) -> None:
        if self._smoothed_us is None:
            self._smoothed_us, self._deviation_us = round_trip_us, round_trip_us / 2
        else:
            self._deviation_us += (abs(round_trip_us - self._smoothed_us) - self._deviation_us) / 4
            self._smoothed_us += (round_trip_us - self._smoothed_us) / 8
        margin_us = 4 * self._deviation_us
        least_us = GRANULARITY_US + self._ack_delay_us  # like the maximum acknowledgement delay, RFC 9002, section 6.2
        timeout_us = self._smoothed_us + (margin_us if margin_us > least_us else least_us)
        self._overdue_us = self._timeout_us = timeout_us if timeout_us > SHORTEST_TIMEOUT_US else SHORTEST_TIMEOUT_US
