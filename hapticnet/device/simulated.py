"""A fingertip device without hardware: kinematics, simulated plant and calibration behind the device interface."""

from typing import Final

import numpy as np

from hapticnet.device.base import Device, Reading
from hapticnet.device.calibration import Calibration
from hapticnet.device.parts import Sensor
from hapticnet.device.plant import Plant, PlantSettings

CALIBRATION_FORCES_N: Final = (0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Forces [N] at which the simulated sensor is calibrated: its data sheet's range, closer where it bends more."""

MAX_FORCE_N: Final = 5.0
"""Largest force [N] the paper's device renders."""


def loading_calibration(sensor: Sensor) -> Calibration:
    """Return what calibrating a sensor with growing weights gives.

    While unloading the sensor then reads up to its hysteresis too much, so that the finger feels too little.
    """
    lowest_n = max(sensor.threshold_n, 0.01)
    forces_n = (lowest_n, *(force_n for force_n in CALIBRATION_FORCES_N if force_n > lowest_n))
    return Calibration(tuple(sensor.counts(force_n) for force_n in forces_n), forces_n)


class SimulatedDevice(Device):
    """Three simulated servos that press a simulated finger.

    Attributes
    ----------
    plant
        The mechanics behind it, for those who want to exchange the finger.
    """

    def __init__(self, settings: PlantSettings, rng: np.random.Generator) -> None:
        self.plant = Plant(settings, rng)
        self.travel_m = settings.linkage.travel_m
        self.max_force_n = MAX_FORCE_N
        self.description = (
            f"simulated device: three HS-55, finger {settings.finger.stiffness_n_m / 1000.0:g} N/mm at 1 N, FSR 408"
        )
        self._linkage = settings.linkage
        self._calibration = loading_calibration(settings.sensor)
        self._displacement_m = 0.0
        self._held_us = self._pulses_us = self.plant.latched_us

    @property
    def contact_force_n(self) -> float:
        """True force [N] on the finger, which no real device knows."""
        return self.plant.contact_force_n

    def exchange(self, displacement_m: float, now_us: int) -> Reading:
        """Hand over the newest platform displacement [m] and get the newest reading."""
        plant = self.plant
        held_us = plant.latched_us
        if displacement_m != self._displacement_m or held_us is not self._held_us:
            self._displacement_m = displacement_m
            self._held_us = held_us
            self._pulses_us = self._linkage.pulses_us(displacement_m, held_us)
        adc = plant.step(self._pulses_us, now_us)
        return Reading(now_us, adc, self._calibration.force_n(adc))
