"""A fingertip device without hardware: the plant, driven like a microcontroller would."""

from dataclasses import replace

import numpy as np

from hapticnet.device.base import Device, Reading
from hapticnet.device.calibration import Calibration
from hapticnet.device.kinematics import Pulses
from hapticnet.device.parts import Sensor
from hapticnet.device.plant import NEVER_US, Plant, PlantSettings
from hapticnet.device.servos import Servos
from hapticnet.hardware import MAX_FORCE_N

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

    Attributes
    ----------
    plant
        The simulated mechanics, for instance to replace the finger.
    """

    def __init__(self, settings: PlantSettings, rng: np.random.Generator) -> None:
        self.plant = Plant(settings, rng)
        self.travel_m = settings.linkage.travel_m
        self.max_force_n = MAX_FORCE_N
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
