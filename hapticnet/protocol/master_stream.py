"""One granted session at the master's end: numbers, seal, acknowledgements, and whether answers are fresh."""

from typing import TYPE_CHECKING, Final

from hapticnet.protocol.messages import WAITED_MS, Position, pack_position
from hapticnet.protocol.seal import LAST_SEQUENCE, Seal
from hapticnet.protocol.stats import REPORT_EVERY, LossEstimate
from hapticnet.protocol.wire import MOST, Datagram, Kind, distance, pack, pack_body, wrap

if TYPE_CHECKING:
    from hapticnet.protocol.stats import ArrivalWindow
from hapticnet.protocol.wire import unwrap


class Freshness:
    """Judge answers by the time stamp of the answered position.

    The slave echoes time stamps of the master, so no clock but the master's counts. An answer is fresh if its position
    is at most `max_age_us` old and was sent at all.
    """

    def __init__(self, max_age_us: int) -> None:
        self.heard_us = 0  # arrival of the last fresh answer that was newer than all before it
        self.too_old_us: int | None = None  # smallest age of the too old answers since then
        self.too_old_at_us: int | None = None  # arrival of the last such answer
        self._max_age_us = max_age_us
        self.newest_t_us = 0  # time [µs] of the newest position that was sent
        self.ahead_us = 0  # how long [µs] after a position the slave may answer, because it follows a line

    def fresh_t_us(self, echoed_t_us: int, now_us: int, *, is_new: bool) -> int | None:
        """Return the unwrapped time [µs] of the answered position; None if the answer is not fresh.

        `is_new` says whether the answer is newer than all before it. Copies of old answers say nothing about the link.
        """
        t_us = unwrap(echoed_t_us, now_us)
        if t_us > self.newest_t_us and t_us > min(self.newest_t_us + self.ahead_us, now_us):
            return None  # no such position was sent
        age_us = now_us - t_us
        # The position behind an answer may be older than the time it answers.
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
        """Return the time [µs] since the last fresh arrival."""
        self.heard_us = min(self.heard_us, now_us)  # a clock that went back must not shorten a silence
        return now_us - self.heard_us


STALE_GROWTH: Final = 1.25
"""Growth of each interval between positions while the link is stale."""


class Pace:
    """Positions at growing intervals while the link is stale, from 1 ms to `slowest_us`, so that it can recover."""

    def __init__(self, slowest_us: int) -> None:
        self._slowest_us = slowest_us
        self._interval_us = 0.0
        self._next_us = 0

    def begin(self, now_us: int) -> None:
        """Begin, because the link has become stale."""
        self._interval_us = 1000.0
        self._next_us = now_us

    def is_due(self, now_us: int) -> bool:
        """Return whether a position is due, and count it as sent."""
        if 0 < self._next_us - now_us <= self._slowest_us:
            return False
        self._interval_us = min(STALE_GROWTH * self._interval_us, self._slowest_us)
        self._next_us = now_us + round(self._interval_us)
        return True


RECENT: Final = 1 << 15
"""A RESET must name one of this many newest sequence numbers; half a minute at 1 kHz. A sealed session ends as many
before its last number."""


class MasterStream:
    """Number and seal datagrams, and keep track of the applied forces.

    `welcome`: sequence number of the WELCOME, which those of the slave's datagrams follow.
    `sparse`: whether positions are few. Each then reports loss, if there is any, and how long what it names has waited.
    """

    def __init__(self, number: int, seal: Seal | None, *, sequence: int, welcome: int, sparse: bool) -> None:
        self.number = number
        self.seal = seal
        self.sequence = sequence  # sequence number of the next datagram to send
        self.newest_force: int | None = None  # sequence number of the newest FORCE applied; None before the first
        self.confirmed: int | None = None  # that number, or that of a KEEPALIVE since which confirmed it
        self._confirmed_us = 0  # when that datagram arrived
        self.loss = LossEstimate(welcome)
        self.window: ArrivalWindow | None = None  # sorts the slave's datagrams; None before it is opened
        self._sparse = sparse
        self._positions = 0
        self._since_us: int | None = None  # start of the wait for an acknowledgement

    @property
    def wears_out(self) -> bool:
        """Whether a sealed session will soon run out of sequence numbers."""
        return self.seal is not None and self.sequence > LAST_SEQUENCE - RECENT

    def pack(self, kind: Kind, body: bytes) -> bytes | None:
        """Return the next datagram; None if no number is left."""
        if self.seal is None:
            datagram = pack(kind, self.number, self.sequence, body)
        elif self.sequence > LAST_SEQUENCE:  # no new session in time: a number must not repeat under one key
            return None
        else:
            datagram = self.seal.pack(kind, self.number, self.sequence, body)
        self.sequence = (self.sequence + 1) & MOST
        return datagram

    def body_of_position(self, t_us: int, payload: bytes) -> bytes:
        """Return the body of a POSITION of time `t_us` [µs], which acknowledges the newest arrivals."""
        self._positions += 1
        self._since_us = None
        is_report = self._sparse or not self._positions % REPORT_EVERY
        loss = self.loss.estimate() if is_report else None
        waited_ms = min(max(t_us - self._confirmed_us, 0) // 1000, int(WAITED_MS.largest)) if self._sparse else 0
        if loss is None and not waited_ms:
            # As `pack_position`, without an object in between.
            return pack_body((t_us & MOST, self.confirmed, payload))
        return pack_position(Position(wrap(t_us), self.confirmed, payload, loss, waited_ms))

    def open(self, data: bytes, datagram: Datagram) -> bytes:
        """Return the body of a datagram of this session; raise PeerError if it does not open."""
        return datagram.body if self.seal is None else self.seal.open(data, datagram)

    def acknowledge(self, sequence: int, now_us: int) -> None:
        """Acknowledge a datagram with the next position."""
        self.confirm(sequence, now_us)
        if self._since_us is None:
            self._since_us = now_us

    def confirm(self, sequence: int, now_us: int) -> None:
        """Name a datagram in the positions to come, without haste."""
        self.confirmed, self._confirmed_us = sequence, now_us

    def owes_since(self, delay_us: int, now_us: int) -> bool:
        """Return whether an acknowledgement has been due for `delay_us`."""
        since_us = self._since_us
        return since_us is not None and not 0 <= now_us - since_us < delay_us

    def sent_lately(self, sequence: int) -> bool:
        """Return whether a sequence number is among the newest sent."""
        return 0 < distance(self.sequence, sequence) <= RECENT

    def is_news(self, sequence: int) -> bool:
        """Return whether a late FORCE is newer than the applied one: only KEEPALIVEs or refused FORCEs overtook it."""
        return self.newest_force is None or distance(sequence, self.newest_force) > 0

    def is_confirmed_by(self, named: int | None) -> bool:
        """Return whether a KEEPALIVE that names a FORCE confirms the applied one: that FORCE or a later one."""
        if named is None or self.newest_force is None:
            return named is self.newest_force
        return distance(self.newest_force, named) >= 0
