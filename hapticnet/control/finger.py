"""What the force loop knows of the finger: where it is and how stiff, learned while it is being pressed.

Two numbers are learned by a Kalman filter: the displacement at which the platform touches the finger, and the
finger's compliance. The measurement is where the platform stands, the regressor what the sensor reads. The filter
weighs both by how much they can be trusted, so a slow drift is taken for a finger that moves and a force that
does not fit the way made is taken for another stiffness.
"""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.hardware import SOFTEST_N_M, STIFFENING, STIFFEST_N_M, STIFFNESS_N_M

LARGEST_CHANGE: Final = 0.5
"""Share of the compliance that one reading may change: a leap of the force is no measurement of a stiffness."""


def compressed(force_n: float) -> float:
    """Return how far a fingertip of 1 N/m at 1 N is compressed by a force [N]; below 0 N its tangent at 0 goes on."""
    if force_n <= 0.0:
        return force_n / (1.0 - STIFFENING)
    return math.log1p(STIFFENING / (1.0 - STIFFENING) * force_n) / STIFFENING


@dataclass(frozen=True, slots=True, kw_only=True)
class FingerSettings:
    """What is known of a finger before it is touched, and how fast that may change.

    Attributes
    ----------
    stiffness_n_m
        Tangent stiffness [N/m] at 1 N, the middle of what fingers have, or what was identified.
    uncertainty
        Standard deviation of its compliance, as a share of it. The first touch is cautious by that much.
    largest_uncertainty
        The same once the finger is known: what may have changed in the meantime.
    position_m
        Standard deviation [m] of where the finger is, when it is touched for the first time.
    reseat_m
        The same when it is touched again. An assumption.
    drift_m
        How far [m] a finger moves in one second by itself. An assumption: what a resting hand does.
    change_m_n
        How much [m/N] its compliance changes in one second by itself. An assumption.
    platform_m
        Standard deviation [m] of where a platform at rest is believed to be: half the gears' play.
    lag_s
        How little [s] the servos' lag is known; 20 to 40 ms is typical of the HS-55. While the platform moves, this
        outweighs all else.

    Raises
    ------
    SettingsError
        If a value is out of its range.
    """

    stiffness_n_m: float = STIFFNESS_N_M
    uncertainty: float = 0.7
    largest_uncertainty: float = 0.3
    position_m: float = 1e-3
    reseat_m: float = 0.5e-3
    drift_m: float = 0.3e-3
    change_m_n: float = 2e-4
    platform_m: float = 0.05e-3
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
    """The finger as far as it is known.

    Attributes
    ----------
    contact_m
        Platform displacement [m] at which it is touched.
    compliance_m_n
        Its compliance [m/N] at 1 N.
    felt
        Whether it was ever touched.
    """

    __slots__ = (
        "_covariance", "_earlier", "_position_var", "_settings", "_variance", "compliance_m_n", "contact_m", "felt",
    )  # fmt: skip

    def __init__(self, settings: FingerSettings) -> None:
        self._settings = settings
        self.forget()

    def forget(self) -> None:
        """Know no more than at the start."""
        settings = self._settings
        self.felt = False
        self.contact_m = 0.0
        self.compliance_m_n = 1.0 / settings.stiffness_n_m
        self._position_var = settings.position_m**2
        self._covariance = 0.0
        self._variance = (settings.uncertainty * self.compliance_m_n) ** 2
        self._earlier: list[tuple[float, float, float, float, float]] = []

    @property
    def cautious_m_n(self) -> float:
        """The compliance [m/N] at 1 N, less one standard deviation: a finger that may be stiffer is taken to be."""
        return max(self.compliance_m_n - math.sqrt(self._variance), 1.0 / STIFFEST_N_M)

    def gain_at(self, force_n: float, elapsed_s: float) -> float:
        """Return what share of a deviation the next update takes for true (0 to 1).

        Parameters
        ----------
        force_n
            The force [N] being held, platform at rest.
        elapsed_s
            Time [s] between two updates.
        """
        compression = compressed(force_n)
        k_position, k_compliance, innovation = self._gains(compression, 0.0)
        drift_m2 = self._settings.drift_m**2 * elapsed_s
        return (k_position + compression * k_compliance + drift_m2) / (innovation + drift_m2)

    def displacement_m(self, force_n: float) -> float:
        """Return where the platform stands [m] when it presses with a force [N]."""
        return self.contact_m + self.compliance_m_n * compressed(force_n)

    def touch(self, displacement_m: float, force_n: float) -> None:
        """Note that the finger was touched here [m], with a first reading [N]."""
        if self.felt:
            self._position_var += self._settings.reseat_m**2
        else:
            self.felt = True
            self.contact_m = displacement_m - self.compliance_m_n * compressed(force_n)

    def recall(self) -> None:
        """Forget what was learned last: a touch that ended while it was measured was measured wrong."""
        if self._earlier:
            belief = self._earlier[0]
            self.contact_m, self.compliance_m_n, self._position_var, self._covariance, self._variance = belief
            self._earlier.clear()

    def learn(self, displacement_m: float, force_n: float, speed_m_s: float, elapsed_s: float) -> None:
        """Take in where the platform stands [m], how fast it moves [m/s], and what the sensor reads [N]."""
        settings = self._settings
        before = self.contact_m, self.compliance_m_n, self._position_var, self._covariance, self._variance
        self._earlier = [*self._earlier[-1:], before]
        self._position_var += settings.drift_m**2 * elapsed_s
        # Uncertainty grows no further than this: a finger held still is not forgotten.
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
        # What the compliance was not allowed to explain, the position does.
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
        """Keep the covariance one, whatever is rounded."""
        self._variance = max(self._variance, 1e-18)
        self._position_var = min(max(self._position_var, 1e-18), self._settings.position_m**2)
        most = 0.999 * math.sqrt(self._position_var * self._variance)
        self._covariance = min(max(self._covariance, -most), most)
