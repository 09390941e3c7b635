"""How a link loses datagrams: measured by the receiver from gaps in sequence numbers, and reported to the sender."""

from typing import Final, NamedTuple

from hapticnet.protocol.serial_number import distance

REPORT_STEPS: Final = 100
"""A report counts in whole per cents, so that each of its numbers takes one byte."""

REPORT_EVERY: Final = 16
"""While there is loss to report, one POSITION in so many carries a report: 125 bytes a second at 1 kHz."""

REORDERED: Final = 3
"""A datagram counts as lost once the third after it has arrived (kPacketThreshold of RFC 9002, section 6.1.1)."""

MEMORY: Final = 512
"""Datagrams over which the share of losses averages: ten seconds of a quiet stream, two of one that is paced."""

REMEMBERED_LOSSES: Final = 256
"""Losses over which the length of bursts averages. The number of datagrams needed depends on it most."""

ASSUMED_ARRIVED: Final = 32.0
"""Datagrams that are assumed to have arrived before the first, so that one early loss does not look like half."""

ASSUMED_LOST: Final = 2.0
"""Losses, the next datagram lost after half of them, that are assumed before the first when bursts are estimated."""

MOST_DATAGRAMS: Final = 200


class Loss(NamedTuple):
    """A chain of two states that steps with each datagram (Gilbert 1960, see `channel.settings`).

    Attributes
    ----------
    share
        Share of the datagrams that are lost, 0 to 1.
    again
        Share of the losses after which the next datagram is lost, too: 1 - 1 / (mean length of a burst).
    """

    share: float
    again: float


NO_LOSS: Final = Loss(0.0, 0.0)


class LossEstimate:
    """The receiver's running estimate.

    Parameters
    ----------
    first
        Sequence number of the datagram that opened the session.
    """

    __slots__ = ("_arrived", "_before_next", "_count", "_lost", "_lost_again", "_newest", "_was_lost")

    def __init__(self, first: int) -> None:
        self._newest = first
        self._arrived = _ALL_ARRIVED  # bit i: the datagram i below the newest has arrived
        self._count = ASSUMED_ARRIVED
        self._lost = 0.0
        self._before_next = ASSUMED_LOST
        self._lost_again = 0.5 * ASSUMED_LOST
        self._was_lost = False

    def arrived(self, sequence: int, *, is_new: bool = False) -> None:
        """Record the arrival of a sequence number that is believed, for the first time.

        `is_new`: whether the numbers go on from it (`ArrivalWindow`).
        """
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
    """Return how many evenly spaced datagrams a window needs so that all of one are lost no more often than that.

    A run of losses begins at a datagram with probability share · (1 - again), and takes n datagrams or more with
    probability again^(n - 1).
    """
    share, again = loss
    starts_per_s = share * (1.0 - again) * 1e6 / window_us
    for datagrams in range(1, MOST_DATAGRAMS):
        if datagrams * starts_per_s * again ** float(datagrams - 1) <= silences_per_s:
            return datagrams
    return MOST_DATAGRAMS
