"""The simulated mechanics: three servos, a fingertip and a force sensor, from pulse widths to converter counts.

The plant takes the pulses of a microcontroller's pins and returns what its converter reads; it does not depend on
displacement commands, servo frames or calibration. The simulated device and the simulated firmware share it.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hapticnet.device.kinematics import Linkage, Pulses
from hapticnet.device.parts import Finger, Sensor, Servo
from hapticnet.device.servos import Servos

NEVER_US: Final = 1 << 62
"""Later than any time stamp, so that the first call only sets the clock."""

NOISE_BLOCK: Final = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSettings:
    """Settings of the simulated mechanics.

    Attributes
    ----------
    linkage
        Arms and pulses.
    servo
        The three servos.
    finger
        The fingertip being pressed.
    sensor
        The force sensor and its converter.
    """

    linkage: Linkage = field(default_factory=Linkage)
    servo: Servo = field(default_factory=Servo)
    finger: Finger = field(default_factory=Finger)
    sensor: Sensor = field(default_factory=Sensor)


class Plant:
    """Three servos that press a fingertip, and the sensor between. The finger is a massless spring.

    Attributes
    ----------
    contact_force_n
        True force [N] between platform and finger.
    """

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
        """Advance time to `now_us` [µs].

        A repeated or earlier time advances nothing, and the clock continues from it.
        """
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
