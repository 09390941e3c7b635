"""Two forces one after the other, through hold and force loop as in a trial, for the measurement of a JND."""

from dataclasses import dataclass
from typing import Final

from hapticnet.control.hold import Hold, HoldSettings
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.procedures import Procedure

LEAD_US: Final = 300_000
"""Time [µs] from the start of a presentation to the first force."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two forces to compare.

    Attributes
    ----------
    forces_n
        The forces [N], in the order in which they come.
    stimulus_us, gap_us
        Duration [µs] of each, and of the gap between them.
    """

    forces_n: tuple[float, float]
    stimulus_us: int
    gap_us: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Presented:
    """What the device made of a pair: held forces, and means [N] and deviations [N] sensed in each second half."""

    held_n: tuple[float, float]
    sensed_n: tuple[float, float]
    deviation_n: tuple[float, float]

    def missed(self, tolerance: float, least_n: float = 0.05) -> str | None:
        """Return why the pair must be presented again; None if both forces were delivered.

        Parameters
        ----------
        tolerance
            Largest error as a share of the held force.
        least_n
            Error [N] that is always tolerated: that of the force loop at rest and of the sensor.
        """
        for held_n, sensed_n in zip(self.held_n, self.sensed_n, strict=True):
            if abs(sensed_n - held_n) > max(tolerance * held_n, least_n):
                return f"{held_n:.3f} N was felt as {sensed_n:.3f} N"
        return None


class Presentation(Procedure):
    """Present a pair. Each force rises and falls as the hold and the limiter let it."""

    def __init__(self, fingertip: Fingertip, pair: Pair) -> None:
        super().__init__(fingertip)
        self._pair = pair
        self._hold = Hold(HoldSettings())
        self._sums = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
        self._interval: int | None = None

    def tick(self, now_us: int) -> bool:
        """Do the next step; return whether both forces are over."""
        elapsed_us = self._elapsed_us(now_us)
        if elapsed_us is None:
            self.fingertip.press(0.0, now_us)
            return False
        pair = self._pair
        at_us = elapsed_us - LEAD_US
        period_us = pair.stimulus_us + pair.gap_us
        interval, within_us = divmod(at_us, period_us) if at_us >= 0 else (0, pair.stimulus_us)
        if interval > 1 or (interval == 1 and within_us >= pair.stimulus_us):
            self.fingertip.press(0.0, now_us)
            return elapsed_us >= LEAD_US + 2 * period_us
        force_n = pair.forces_n[interval] if within_us < pair.stimulus_us else 0.0
        self._hold.receive((force_n,), now_us)  # as a packet of each tick would
        self.fingertip.press(self._hold.value(now_us)[0], now_us)
        if pair.stimulus_us // 2 <= within_us < pair.stimulus_us and (reading := self.fingertip.reading) is not None:
            sums = self._sums[interval]
            sums[0] += 1.0
            sums[1] += reading.force_n
            sums[2] += reading.force_n**2
        return False

    def result(self) -> Presented:
        """Return what was felt."""
        means, deviations = [], []
        for count, total_n, squares in self._sums:
            mean_n = total_n / count if count else 0.0
            means.append(mean_n)
            deviations.append(max(squares / count - mean_n**2, 0.0) ** 0.5 if count else 0.0)
        return Presented(
            held_n=self._pair.forces_n, sensed_n=(means[0], means[1]), deviation_n=(deviations[0], deviations[1])
        )
