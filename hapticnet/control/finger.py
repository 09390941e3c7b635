"""The force loop's model of the finger: its position and stiffness, learned while it is pressed.

A Kalman filter estimates two numbers: the displacement at which the platform touches the finger, and the finger's
compliance. The measurement is the position of the platform, the regressor the sensed force. The filter weighs both by
their uncertainty, so it attributes a slow drift to motion of the finger, and a force that does not match the motion to
a different stiffness.
"""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.hardware import SOFTEST_N_M, STIFFENING, STIFFEST_N_M, STIFFNESS_N_M

LARGEST_CHANGE: Final = 0.5
"""Largest relative change of the compliance per reading: a jump of the force is not a measurement of stiffness."""


def compressed(force_n: float) -> float:
    """Return the compression at a force [N] of a fingertip of 1 N/m at 1 N; linear, with the slope at 0, below 0 N."""
    if force_n <= 0.0:
        return force_n / (1.0 - STIFFENING)
    return math.log1p(STIFFENING / (1.0 - STIFFENING) * force_n) / STIFFENING


@dataclass(frozen=True, slots=True, kw_only=True)
class FingerSettings:
    """Prior knowledge of a finger, and how fast it may change."""

    # Tangent stiffness [N/m] at 1 N: the middle of the typical range, or the identified value
    stiffness_n_m: float = STIFFNESS_N_M
    # Relative standard deviation of the compliance. The first touch is cautious by this amount.
    uncertainty: float = 0.7
    largest_uncertainty: float = 0.3  # the same once the finger is known: limits the effect of later changes
    position_m: float = 1e-3  # standard deviation [m] of the finger's position at the first touch
    reseat_m: float = 0.5e-3  # the same at a later touch. An assumption.
    drift_m: float = 0.3e-3  # spontaneous motion [m] of a finger in one second. An assumption for a resting hand.
    change_m_n: float = 2e-4  # spontaneous change [m/N] of the compliance in one second. An assumption.
    # Standard deviation [m] of the estimated position of a resting platform: half the gears' play
    platform_m: float = 0.05e-3
    # Uncertainty [s] of the servos' lag; 20 to 40 ms is typical of the HS-55. While the platform moves, this is the
    # dominant uncertainty.
    lag_s: float = 0.01

    def __post_init__(self) -> None:
        check_parameter("finger stiffness", self.stiffness_n_m, SOFTEST_N_M, STIFFEST_N_M, "N/m")
        check_parameter("uncertainty of the compliance", self.uncertainty, 0.0, 1.0)
        check_parameter("largest uncertainty of the compliance", self.largest_uncertainty, 0.0, 1.0)
        check_parameter("uncertainty of the finger's position", self.position_m, 1e-6, 0.1, "m")
        check_parameter("uncertainty of a finger touched again", self.reseat_m, 0.0, 0.1, "m")
        check_parameter("finger drift", self.drift_m, 0.0, 0.1, "m/s")
        check_parameter("change of compliance", self.change_m_n, 0.0, 0.1, "m/N/s")
        check_parameter("uncertainty of the platform", self.platform_m, 1e-6, 0.1, "m")
        check_parameter("uncertainty of the servos' lag", self.lag_s, 0.0, 1.0, "s")


class LearnedFinger:
    """Estimate of the finger."""

    __slots__ = (
        "_covariance", "_earlier", "_position_var", "_settings", "_variance", "compliance_m_n", "contact_m", "felt",
    )  # fmt: skip

    def __init__(self, settings: FingerSettings) -> None:
        self._settings = settings
        self.forget()

    def forget(self) -> None:
        """Return to the prior."""
        settings = self._settings
        self.felt = False  # whether the finger was ever touched
        self.contact_m = 0.0  # platform displacement [m] at which it touches the finger
        self.compliance_m_n = 1.0 / settings.stiffness_n_m  # compliance [m/N] at 1 N
        self._position_var = settings.position_m**2
        self._covariance = 0.0
        self._variance = (settings.uncertainty * self.compliance_m_n) ** 2
        self._earlier: list[tuple[float, float, float, float, float]] = []

    @property
    def cautious_m_n(self) -> float:
        """The compliance [m/N] at 1 N less one standard deviation, so that a stiff finger is not overloaded."""
        return max(self.compliance_m_n - math.sqrt(self._variance), 1.0 / STIFFEST_N_M)

    def gain_at(self, force_n: float, elapsed_s: float) -> float:
        """Return the share (0 to 1) of a deviation that the next update attributes to a finger held at a force [N]."""
        compression = compressed(force_n)
        k_position, k_compliance, innovation = self._gains(compression, 0.0)
        drift_m2 = self._settings.drift_m**2 * elapsed_s
        return (k_position + compression * k_compliance + drift_m2) / (innovation + drift_m2)

    def displacement_m(self, force_n: float) -> float:
        """Return the displacement [m] of the platform at which it presses with a force [N]."""
        return self.contact_m + self.compliance_m_n * compressed(force_n)

    def touch(self, displacement_m: float, force_n: float) -> None:
        """Note a touch at a displacement [m] with a first reading [N]."""
        if self.felt:
            self._position_var += self._settings.reseat_m**2
        else:
            self.felt = True
            self.contact_m = displacement_m - self.compliance_m_n * compressed(force_n)

    def recall(self) -> None:
        """Discard the last updates: a touch that ended during the measurement gave wrong values."""
        if self._earlier:
            belief = self._earlier[0]
            self.contact_m, self.compliance_m_n, self._position_var, self._covariance, self._variance = belief
            self._earlier.clear()

    def learn(self, displacement_m: float, force_n: float, speed_m_s: float, elapsed_s: float) -> None:
        """Update with the position [m] and speed [m/s] of the platform and the sensed force [N]."""
        settings = self._settings
        before = self.contact_m, self.compliance_m_n, self._position_var, self._covariance, self._variance
        self._earlier = [*self._earlier[-1:], before]
        self._position_var += settings.drift_m**2 * elapsed_s
        # Limited, so that the filter does not forget a finger held at rest.
        largest = (settings.largest_uncertainty * self.compliance_m_n) ** 2
        if self._variance < largest:
            self._variance = min(self._variance + settings.change_m_n**2 * elapsed_s, largest)
        compression = compressed(force_n)
        error_m = displacement_m - self.contact_m - self.compliance_m_n * compression
        k_position, k_compliance, innovation = self._gains(compression, speed_m_s)
        wanted_m_n = self.compliance_m_n + k_compliance / innovation * error_m
        least_m_n = max((1.0 - LARGEST_CHANGE) * self.compliance_m_n, 1.0 / STIFFEST_N_M)
        most_m_n = min((1.0 + LARGEST_CHANGE) * self.compliance_m_n, 1.0 / SOFTEST_N_M)
        self.compliance_m_n = min(max(wanted_m_n, least_m_n), most_m_n)
        # The position absorbs what the limits of the compliance cut off.
        self.contact_m += k_position / innovation * error_m + (wanted_m_n - self.compliance_m_n) * compression
        self._position_var -= k_position * k_position / innovation
        self._covariance -= k_position * k_compliance / innovation
        self._variance -= k_compliance * k_compliance / innovation
        self._bound()

    def _gains(self, compression: float, speed_m_s: float) -> tuple[float, float, float]:
        settings = self._settings
        k_position = self._position_var + self._covariance * compression
        k_compliance = self._covariance + self._variance * compression
        noise_m2 = settings.platform_m**2 + (settings.lag_s * speed_m_s) ** 2
        return k_position, k_compliance, k_position + compression * k_compliance + noise_m2

    def _bound(self) -> None:
        """Keep the covariance matrix positive definite despite rounding."""
        self._variance = max(self._variance, 1e-18)
        self._position_var = min(max(self._position_var, 1e-18), self._settings.position_m**2)
        most = 0.999 * math.sqrt(self._position_var * self._variance)
        self._covariance = min(max(self._covariance, -most), most)
