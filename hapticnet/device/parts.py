"""Parts of the simulated device: servo, finger and sensor, each number with its source."""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.hardware import (
    CONTACT_M,
    SENSOR_THRESHOLD_N,
    SERVO_DEADBAND_US,
    SERVO_FRAME_US,
    SERVO_LAG_S,
    STIFFENING,
    STIFFNESS_N_M,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Servo:
    """An HS-55 hobby servo.

    Attributes
    ----------
    frame_us
        Period [µs] at which it takes a new pulse.
    deadband_us
        Change of pulse [µs] below which it does not move.
    lag_s
        Time constant [s] of its first-order lag.
    rate_deg_s
        Largest speed [deg/s]: 60° in 0.17 s at 4.8 V, HS-55 data sheet.
    backlash_deg
        Play of the gears [deg] at the arm; 0.5 is typical of plastic gears.
    stall_nm
        Stall torque [N·m]; 0.108 at 4.8 V is typical.
    """

    frame_us: int = SERVO_FRAME_US
    deadband_us: float = SERVO_DEADBAND_US
    lag_s: float = SERVO_LAG_S
    rate_deg_s: float = 353.0
    backlash_deg: float = 0.5
    stall_nm: float = 0.108

    def __post_init__(self) -> None:
        check_parameter("servo frame", self.frame_us, 1_000, 100_000, "µs")
        check_parameter("servo deadband", self.deadband_us, 0.0, 50.0, "µs")
        check_parameter("servo lag", self.lag_s, 1e-4, 1.0, "s")
        check_parameter("servo speed limit", self.rate_deg_s, 1.0, 1e5, "deg/s")
        check_parameter("servo backlash", self.backlash_deg, 0.0, 10.0, "deg")
        check_parameter("servo stall torque", self.stall_nm, 1e-4, 10.0, "N·m")


LEAST_STIFFENING: Final = 1e-12
"""Share below which a finger is a linear spring: the difference is smaller than rounding, and the quotients below would
overflow at the smallest numbers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finger:
    """A fingertip pressed by a flat plate: its force grows exponentially with compression.

    ``force = k0 / b · (exp(b · compression) − 1)``, see `hapticnet.hardware.STIFFENING`; k0 and b give the tangent
    stiffness ``k0 + b · force`` the value `stiffness_n_m` at 1 N.

    Attributes
    ----------
    stiffness_n_m
        Tangent stiffness [N/m] at 1 N.
    stiffening
        Share of that stiffness which comes from the force (dimensionless, 0 to 0.9); 0 is a linear spring.
    contact_m
        Platform displacement [m] at which it touches the finger.
    """

    stiffness_n_m: float = STIFFNESS_N_M
    stiffening: float = STIFFENING
    contact_m: float = CONTACT_M

    def __post_init__(self) -> None:
        check_parameter("finger stiffness", self.stiffness_n_m, 1.0, 1e5, "N/m")
        check_parameter("finger stiffening", self.stiffening, 0.0, 0.9)
        check_parameter("finger contact", self.contact_m, 0.0, 1.0, "m")

    def force_n(self, displacement_m: float) -> float:
        """Return the force [N] on a platform at `displacement_m` [m]; never negative, because skin does not stick."""
        compression_m = displacement_m - self.contact_m
        if compression_m <= 0.0:
            return 0.0
        if self.stiffening < LEAST_STIFFENING:
            return self.stiffness_n_m * compression_m
        growth = self.stiffening * self.stiffness_n_m
        return (1.0 - self.stiffening) / self.stiffening * math.expm1(min(growth * compression_m, 50.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """An FSR 408 with a divider resistor to ground and the ATmega328P's 10-bit converter.

    Conductance is ``force ** exponent / ohm_at_1_n`` above the threshold and zero below; the counts are
    ``2 ** adc_bits · R · G / (1 + R · G)``. Interlink's FSR 400 series data sheet gives threshold, hysteresis and an
    open resistance above 10 MΩ (here: no conductance). Drift (under 5 % per decade of time) is not modelled.

    Attributes
    ----------
    threshold_n
        Force [N] below which it does not conduct.
    ohm_at_1_n
        Resistance [Ω] at 1 N; about 9.5 kΩ is typical.
    exponent
        Exponent of the conductance (dimensionless); 0.9 to 1.1 is typical.
    hysteresis
        Relative decrease of the resistance at the same force during unloading; 10 % on average, data sheet.
    divider_ohm
        Resistance of the divider [Ω].
    adc_bits
        Resolution of the converter.
    noise_counts
        Standard deviation [counts] of the noise of a reading; about one count is typical of this converter.
    """

    threshold_n: float = SENSOR_THRESHOLD_N
    ohm_at_1_n: float = 9500.0
    exponent: float = 1.0
    hysteresis: float = 0.1
    divider_ohm: float = 10_000.0
    adc_bits: int = 10
    noise_counts: float = 1.0

    def __post_init__(self) -> None:
        check_parameter("sensor threshold", self.threshold_n, 0.0, 5.0, "N")
        check_parameter("sensor resistance at 1 N", self.ohm_at_1_n, 10.0, 1e7, "Ω")
        check_parameter("sensor exponent", self.exponent, 0.5, 2.0)
        check_parameter("sensor hysteresis", self.hysteresis, 0.0, 0.9)
        check_parameter("divider", self.divider_ohm, 10.0, 1e7, "Ω")
        check_parameter("converter bits", self.adc_bits, 8, 16)
        check_parameter("sensor noise", self.noise_counts, 0.0, 100.0, "counts")

    @property
    def unloading_gain(self) -> float:
        """Factor by which the sensor overestimates the force during unloading (dimensionless, 1 or more)."""
        return math.pow(1.0 - self.hysteresis, -1.0 / self.exponent)

    def counts(self, force_n: float) -> float:
        """Return the converter's mean counts at a force [N] during loading, without noise or rounding."""
        if force_n < self.threshold_n:
            return 0.0
        ratio = self.divider_ohm / self.ohm_at_1_n * math.pow(force_n, self.exponent)
        return (1 << self.adc_bits) * ratio / (1.0 + ratio)
