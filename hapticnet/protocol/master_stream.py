"""One granted session at the master's end: its numbers, its seal, and what is acknowledged in it."""

from typing import TYPE_CHECKING, Final

from hapticnet.protocol.loss import REPORT_EVERY, LossEstimate
from hapticnet.protocol.messages import Position, pack_position
from hapticnet.protocol.seal import LAST_SEQUENCE, Seal
from hapticnet.protocol.serial_number import MOST, distance, wrap
from hapticnet.protocol.wire import Datagram, Kind, pack, pack_body

if TYPE_CHECKING:
    from hapticnet.protocol.arrivals import ArrivalWindow

RECENT: Final = 1 << 15
"""A RESET must name one of so many newest sequence numbers; half a minute at 1 kHz. A sealed session ends as many
before its last number."""


class MasterStream:
    """Number and seal what is sent, and keep account of the forces that are applied.

    Parameters
    ----------
    number
        Number of the session, never 0.
    seal
        Of a sealed session; None for an open one.
    sequence
        Sequence number of the first datagram to send.
    welcome
        Sequence number of the WELCOME, which those of the slave's datagrams follow.
    reports_loss
        Whether each position reports loss, if there is any: positions are few.

    Attributes
    ----------
    sequence
        Sequence number of the next datagram to send.
    newest_force
        Sequence number of the newest FORCE applied; None before the first.
    confirmed
        That number, or that of a KEEPALIVE since which confirmed it.
    window
        Sorts the slave's datagrams; None before it is opened.
    """

    __slots__ = (
        "_positions", "_reports_loss", "_since_us", "confirmed", "loss", "newest_force", "number", "seal", "sequence",
        "window",
    )  # fmt: skip

    def __init__(self, number: int, seal: Seal | None, *, sequence: int, welcome: int, reports_loss: bool) -> None:
        self.number = number
        self.seal = seal
        self.sequence = sequence
        self.newest_force: int | None = None
        self.confirmed: int | None = None
        self.loss = LossEstimate(welcome)
        self.window: ArrivalWindow | None = None
        self._reports_loss = reports_loss
        self._positions = 0
        self._since_us: int | None = None  # since when something waits to be acknowledged

    @property
    def wears_out(self) -> bool:
        """Whether a sealed session will soon have no sequence number left."""
        return self.seal is not None and self.sequence > LAST_SEQUENCE - RECENT

    def pack(self, kind: Kind, body: bytes) -> bytes | None:
        """Return the next datagram; None if there is no number left."""
        if self.seal is None:
            datagram = pack(kind, self.number, self.sequence, body)
        elif self.sequence > LAST_SEQUENCE:  # no new session in time: a number must not come twice under one key
            return None
        else:
            datagram = self.seal.pack(kind, self.number, self.sequence, body)
        self.sequence = (self.sequence + 1) & MOST
        return datagram

    def body_of_position(self, t_us: int, payload: bytes) -> bytes:
        """Return the body of a POSITION of time `t_us` [µs], which acknowledges what has arrived."""
        self._positions += 1
        self._since_us = None
        is_report = self._reports_loss or not self._positions % REPORT_EVERY
        loss = self.loss.estimate() if is_report else None
        if loss is None:
            # As `pack_position`, without an object in between.
            return pack_body((t_us & MOST, self.confirmed, payload))
        return pack_position(Position(wrap(t_us), self.confirmed, payload, loss))

    def open(self, data: bytes, datagram: Datagram) -> bytes:
        """Return the body of a datagram of this session; raise PeerError if it does not open."""
        return datagram.body if self.seal is None else self.seal.open(data, datagram)

    def acknowledge(self, sequence: int, now_us: int) -> None:
        """Acknowledge a datagram with the next position."""
        self.confirmed = sequence
        if self._since_us is None:
            self._since_us = now_us

    def owes_since(self, delay_us: int, now_us: int) -> bool:
        """Return whether something has waited to be acknowledged for `delay_us`."""
        since_us = self._since_us
        return since_us is not None and not 0 <= now_us - since_us < delay_us

    def sent_lately(self, sequence: int) -> bool:
        """Return whether a sequence number is one of the newest that were sent."""
        return 0 < distance(self.sequence, sequence) <= RECENT

    def is_news(self, sequence: int) -> bool:
        """Return whether a late FORCE is newer than the one applied: only KEEPALIVEs or refused FORCEs overtook it."""
        return self.newest_force is None or distance(sequence, self.newest_force) > 0

    def is_confirmed_by(self, named: int | None) -> bool:
        """Return whether a KEEPALIVE that names a FORCE confirms what is applied: that FORCE or one after it."""
        if named is None or self.newest_force is None:
            return named is self.newest_force
        return distance(self.newest_force, named) >= 0
