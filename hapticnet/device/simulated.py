"""A fingertip device without hardware: finger, force sensor, mechanics, and the device that drives them."""

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from hapticnet.checks import check_parameter
from hapticnet.device.base import Device, Reading, presses
from hapticnet.device.calibration import Calibration
from hapticnet.device.servos import Linkage, Pulses, Servo, Servos
from hapticnet.hardware import CONTACT_M, SENSOR_THRESHOLD_N, STIFFENING, STIFFNESS_N_M

LEAST_STIFFENING: Final = 1e-12  # share below which a finger is a linear spring; the quotients below would overflow


@dataclass(frozen=True, slots=True, kw_only=True)
class Finger:
    """A fingertip pressed by a flat plate: its force grows exponentially with compression.

    ``force = k0 / b · (exp(b · compression) − 1)``, see `hapticnet.hardware.STIFFENING`; k0 and b give the tangent
    stiffness ``k0 + b · force`` the value `stiffness_n_m` at 1 N.
    """

    stiffness_n_m: float = STIFFNESS_N_M  # tangent stiffness [N/m] at 1 N
    stiffening: float = STIFFENING  # share of that stiffness from the force, 0 to 0.9; 0 is a linear spring
    contact_m: float = CONTACT_M  # platform displacement [m] at which it touches the finger

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
    """

    threshold_n: float = SENSOR_THRESHOLD_N  # force [N] below which it does not conduct
    ohm_at_1_n: float = 9500.0  # resistance [Ω] at 1 N; about 9.5 kΩ is typical
    exponent: float = 1.0  # exponent of the conductance (dimensionless); 0.9 to 1.1 is typical
    hysteresis: float = 0.1  # relative decrease of the resistance during unloading; 10 % on average, data sheet
    divider_ohm: float = 10_000.0  # resistance of the divider [Ω]
    adc_bits: int = 10  # resolution of the converter
    noise_counts: float = 1.0  # standard deviation [counts] of the noise of a reading; typical of this converter

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


NEVER_US: Final = 1 << 62  # later than any time stamp, so that the first call only sets the clock
NOISE_BLOCK: Final = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSettings:
    """Settings of the simulated mechanics."""

    linkage: Linkage = field(default_factory=Linkage)  # arms and pulses
    servo: Servo = field(default_factory=Servo)  # the three servos
    finger: Finger = field(default_factory=Finger)  # the fingertip being pressed
    sensor: Sensor = field(default_factory=Sensor)  # the force sensor and its converter


class Plant:
    """Three servos that press a fingertip, a massless spring, with `contact_force_n` [N], and the sensor between."""

    __slots__ = (
        "_finger", "_full_scale", "_loaded_n", "_mean_counts", "_noise", "_noise_at", "_now_us", "_rng", "_sensor",
        "_servos", "_stall_n", "_unloading_gain", "contact_force_n",
    )  # fmt: skip

    def __init__(self, settings: PlantSettings, rng: np.random.Generator) -> None:
        self._servos = Servos(settings.linkage, settings.servo)
        self._finger = settings.finger
        self._sensor = settings.sensor
        self._unloading_gain = settings.sensor.unloading_gain
        self._stall_n = 3.0 * settings.servo.stall_nm / settings.linkage.arm_m
        self._full_scale = (1 << settings.sensor.adc_bits) - 1
        self._rng = rng
        self._noise: list[float] = []
        self._noise_at = 0
        self._now_us = float(NEVER_US)
        self._loaded_n = 0.0
        self._press()

    @property
    def displacement_m(self) -> float:
        """True mean height [m] of the platform above retracted."""
        return self._servos.displacement_m

    def take(self, pulses_us: Pulses) -> None:
        """Give each servo a pulse [µs] now: one frame."""
        self._servos.take(pulses_us)

    def take_one(self, index: int, pulse_us: float) -> None:
        """Give one servo (0 to 2) a pulse [µs] that ends now."""
        self._servos.take_one(index, pulse_us)

    def advance(self, now_us: float) -> None:
        """Advance time to `now_us` [µs]; a repeated or earlier one only sets the clock."""
        elapsed_us = now_us - self._now_us
        self._now_us = now_us
        if self._servos.move(elapsed_us):
            self._press()

    def read(self) -> int:
        """Return the converter's reading [counts], with noise and rounding."""
        if self._mean_counts <= 0.0:
            return 0
        counts = int(self.level_counts())
        return 0 if counts < 0 else min(counts, self._full_scale)

    def level_counts(self) -> float:
        """Return the level at the converter's pin [counts], with noise."""
        mean = self._mean_counts
        if mean <= 0.0:
            return 0.0
        at = self._noise_at
        if at == len(self._noise):
            self._noise = self._rng.normal(0.0, self._sensor.noise_counts, NOISE_BLOCK).tolist()
            at = 0
        self._noise_at = at + 1
        return mean + self._noise[at]

    def exchange_finger(self, finger: Finger) -> None:
        """Replace the finger, for instance by a stiffer or a withdrawn one during a run."""
        self._finger = finger
        self._press()

    def _press(self) -> None:
        force_n = self.contact_force_n = min(self._finger.force_n(self._servos.displacement_m), self._stall_n)
        # Play operator with a gap proportional to the load: loading follows its lower edge, unloading its upper edge.
        self._loaded_n = min(max(self._loaded_n, force_n), force_n * self._unloading_gain)
        self._mean_counts = self._sensor.counts(self._loaded_n)


CALIBRATION_FORCES_N = (0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Forces [N] at which the simulated sensor is calibrated: the range of its data sheet, denser where it is curved."""


def loading_calibration(sensor: Sensor) -> Calibration:
    """Return the calibration of a sensor with increasing weights.

    During unloading the reading is then too high by up to the sensor's hysteresis, so the finger feels too little.
    """
    lowest_n = max(sensor.threshold_n, 0.01)
    forces_n = (lowest_n, *(force_n for force_n in CALIBRATION_FORCES_N if force_n > lowest_n))
    return Calibration(tuple(sensor.counts(force_n) for force_n in forces_n), forces_n)


class SimulatedDevice(Device):
    """Three simulated servos that press a simulated finger.

    Pulses wait for the next servo frame, at multiples of the frame period on the caller's clock. The frame takes the
    newest pulses set before it begins, or those of a call at the same time.
    """

    def __init__(self, settings: PlantSettings, rng: np.random.Generator) -> None:
        self.plant = Plant(settings, rng)  # the simulated mechanics, for instance to replace the finger
        self.capabilities = presses(settings.linkage.travel_m)
        self.description = (
            f"simulated device: three HS-55, finger {settings.finger.stiffness_n_m / 1000.0:g} N/mm at 1 N, FSR 408"
        )
        self.status = "ready"
        self._linkage = settings.linkage
        self._frame_us = settings.servo.frame_us
        self._calibration = loading_calibration(settings.sensor)
        self._known = Servos(settings.linkage, replace(settings.servo, backlash_deg=0.0))
        self._now_us = NEVER_US
        self._next_frame_us = NEVER_US
        self._displacement_m = 0.0
        self._held_us = self._pulses_us = self._known.taken_us

    @property
    def contact_force_n(self) -> float:
        """True force [N] on the finger, unknown to real devices."""
        return self.plant.contact_force_n

    def exchange(self, displacement_m: float, now_us: int) -> Reading:
        """Set the platform displacement [m] and return the newest reading.

        A repeated or earlier time advances nothing, and the clock continues from it.
        """
        handed_us = self._pulses_us
        held_us = self._known.taken_us
        if displacement_m != self._displacement_m or held_us is not self._held_us:
            self._displacement_m = displacement_m
            self._held_us = held_us
            self._pulses_us = self._linkage.pulses_us(displacement_m, held_us)
        if now_us >= self._next_frame_us:
            self._cross_frames(handed_us, now_us)
        else:
            if now_us < self._now_us:
                self._next_frame_us = now_us - now_us % self._frame_us + self._frame_us
            self._advance(now_us)
        adc = self.plant.read()
        return Reading(now_us, adc, self._calibration.force_n(adc), self._known.displacement_m)

    def _cross_frames(self, handed_us: Pulses, now_us: int) -> None:
        frame_us = self._next_frame_us
        last_frame_us = now_us - now_us % self._frame_us
        self._advance(frame_us)
        # Repeating the same pulses at later frames changes nothing, so a long gap is one motion.
        self._take(self._pulses_us if frame_us == now_us else handed_us)
        self._advance(now_us)
        if frame_us < last_frame_us == now_us:
            self._take(self._pulses_us)
        self._next_frame_us = last_frame_us + self._frame_us

    def _take(self, pulses_us: Pulses) -> None:
        self.plant.take(pulses_us)
        self._known.take(pulses_us)

    def _advance(self, now_us: int) -> None:
        self.plant.advance(now_us)
        self._known.move(now_us - self._now_us)
        self._now_us = now_us
