"""Weber's law and the published force thresholds that hapticnet starts from."""

from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Final

from hapticnet.checks import check_parameter

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

SUBJECT_JND_N = (0.05, 0.04, 0.06, 0.05, 0.05, 0.06, 0.05, 0.04)
"""Force JND [N] of the eight subjects of "Cutaneous haptic deadband compression", ascending method of limits."""

JND_REFERENCE_FORCES_N = (0.5, 1.0, 1.5)  # reference forces [N] at which those JNDs were measured

PAPER_WEBER_FRACTION: Final = round(fmean(SUBJECT_JND_N) / fmean(JND_REFERENCE_FORCES_N), 9)
"""Mean JND of the eight subjects over their mean reference force: k = 0.05 N / 1 N."""

PAPER_FLOOR_N: Final = PAPER_WEBER_FRACTION * min(JND_REFERENCE_FORCES_N)
"""JND at the weakest force the paper tested, 0.025 N.

Weber's law is not supported below the weakest force tested, and k·|I| vanishes with the force, so that noise alone
would trigger the deadband. Below 0.5 N the JND is therefore constant.
"""

SMALLEST: Final = 1e-12
"""Smallest nonzero Weber fraction, floor [N] and multiplier: far below any sense, yet errors in JNDs stay finite."""

LARGEST_FRACTION: Final = 1.0
LARGEST_FLOOR_N: Final = 1e9
LARGEST_MULTIPLIER: Final = 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class WeberLaw:
    """The threshold at which two stimuli can be distinguished.

    ``threshold(ref) = multiplier · max(weber_fraction · |ref|, floor_n)``, with ``|·|`` the Euclidean norm.

    Attributes
    ----------
    weber_fraction
        JND as a fraction of the reference stimulus (dimensionless, 0 to 1). Weber 1834; k·|I| in the paper.
    floor_n
        Smallest JND [N]; applies where k·|I| is below it.
    multiplier
        Threshold in JNDs. The paper's conditions are 1, 2 and 4.

    Raises
    ------
    SettingsError
        If a value is not finite, negative or too large, or nonzero and too small to divide by.
    """

    weber_fraction: float = PAPER_WEBER_FRACTION
    floor_n: float = PAPER_FLOOR_N
    multiplier: float = 1.0

    def __post_init__(self) -> None:
        for name, value, largest in (
            ("Weber fraction", self.weber_fraction, LARGEST_FRACTION),
            ("JND floor", self.floor_n, LARGEST_FLOOR_N),
            ("JND multiplier", self.multiplier, LARGEST_MULTIPLIER),
        ):
            check_parameter(name, value, SMALLEST, largest, zero_allowed=True)

    def jnd_n(self, reference_n: float) -> float:
        """Return the just-noticeable difference [N] from a stimulus of magnitude `reference_n` [N]."""
        return max(self.weber_fraction * reference_n, self.floor_n)

    def jnds_n(self, references_n: "npt.NDArray[np.float64]") -> "npt.NDArray[np.float64]":
        """Return `jnd_n` for an array of magnitudes [N]."""
        import numpy as np

        return np.maximum(self.weber_fraction * references_n, self.floor_n)

    def threshold_n(self, reference_n: float) -> float:
        """Return the deadband threshold [N] around a stimulus of magnitude `reference_n` [N]."""
        # The multiplier is inside, so that array code can hoist it out of its loop and still get the same bits.
        return max(self.multiplier * self.weber_fraction * reference_n, self.multiplier * self.floor_n)

    def thresholds_n(self, references_n: "npt.NDArray[np.float64]") -> "npt.NDArray[np.float64]":
        """Return `threshold_n` for an array of magnitudes [N], identical to the bit."""
        import numpy as np

        return np.maximum(self.multiplier * self.weber_fraction * references_n, self.multiplier * self.floor_n)
