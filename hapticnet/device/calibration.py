"""From the force sensor's counts to newton: a monotone piecewise-linear table."""

import math
from bisect import bisect_right
from dataclasses import dataclass

from hapticnet.errors import SettingsError


@dataclass(frozen=True, slots=True)
class Calibration:
    """Pairs of converter counts and the force that gave them, joined by straight lines.

    Below the first pair the force falls in a straight line to 0 N at 0 counts; above the last it stays at the last
    pair's force, because a sensor beyond its range says only "at least that".

    Attributes
    ----------
    counts
        Converter counts, positive and strictly increasing.
    forces_n
        The force [N] at each of them, positive and strictly increasing.

    Raises
    ------
    SettingsError
        When there are fewer than two pairs, or a column is not finite, positive and strictly increasing.

    Examples
    --------
    >>> Calibration(counts=(100.0, 200.0), forces_n=(0.5, 2.5)).force_n(150)
    1.5
    """

    counts: tuple[float, ...]
    forces_n: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.counts) != len(self.forces_n) or len(self.counts) < 2:
            raise SettingsError(
                f"calibration has {len(self.counts)} counts and {len(self.forces_n)} forces; "
                "it needs as many of one as of the other, and two at least"
            )
        for name, column in (("counts", self.counts), ("forces [N]", self.forces_n)):
            for before, after in zip((0.0, *column), column, strict=False):
                if not before < after < math.inf:
                    raise SettingsError(
                        f"calibration {name} go from {before:g} to {after:g}; "
                        "they must be finite, above 0 and strictly increasing"
                    )

    def force_n(self, adc: float) -> float:
        """Return the force [N] that belongs to a reading in counts (averaged readings may have a fraction)."""
        counts = self.counts
        if adc <= 0.0:
            return 0.0
        # Written so that NaN gives the largest force, from which the force loop retracts.
        if not adc < counts[-1]:
            return self.forces_n[-1]
        above = bisect_right(counts, adc)
        high, force_high_n = counts[above], self.forces_n[above]
        low, force_low_n = (counts[above - 1], self.forces_n[above - 1]) if above else (0.0, 0.0)
        return force_low_n + (adc - low) / (high - low) * (force_high_n - force_low_n)
