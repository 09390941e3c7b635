"""The simulated mechanics: three servos, a fingertip and a force sensor, from pulse widths to converter counts.

Nothing here knows displacement commands or calibrations: it takes what a microcontroller's pins put out and gives
what its converter reads, so the simulated device and the simulated firmware press the same finger.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hapticnet.device.kinematics import Linkage, Pulses
from hapticnet.device.parts import Finger, Sensor, Servo

NEVER_US: Final = 1 << 62
"""Later than any time stamp, so that the first call only sets the clock."""

AT_REST_US: Final = 0.01
"""A servo this near its goal [µs of pulse] is there: 0.2 µm of platform."""

NOISE_BLOCK: Final = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSettings:
    """The whole simulated device.

    Attributes
    ----------
    linkage
        Arms and pulses.
    servo
        Each of the three servos.
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
    """Three servos that press a fingertip, and the sensor that feels it.

    Each servo takes the newest pulse when a frame begins (multiples of the frame period on the caller's clock). It
    follows a pulse that is at least its deadband away from where it stands or from where it is heading, as a
    first-order lag whose speed is limited, and its arm follows through the gears' backlash. Between frames the
    motion is a closed form, so the steps' size does not matter.

    Backlash is a play operator, as if friction held the arm: pessimistic, because a pressed finger loads the gears to
    one side. The finger is a massless spring.

    Attributes
    ----------
    contact_force_n
        True force [N] between platform and finger.
    displacement_m
        True mean height [m] of the platform above retracted.
    latched_us
        The pulses [µs] the servos took at the last frame.
    """

    __slots__ = (
        "_arms_us", "_counts", "_finger", "_full_scale", "_goals_us", "_half_play_us", "_handed_us", "_lag_decay",
        "_lag_decay_us", "_loaded_n", "_lowest", "_mean_counts", "_moving", "_next_frame_us", "_noise", "_noise_at",
        "_now_us", "_radians_per_us", "_rate", "_rng", "_servos_us", "_settings", "_slow_us", "_stall_n",
        "contact_force_n", "displacement_m", "latched_us",
    )  # fmt: skip

    def __init__(self, settings: PlantSettings, rng: np.random.Generator) -> None:
        retracted_us = settings.linkage.retracted_us
        self._settings = settings
        self._rng = rng
        self._noise: list[float] = []
        self._noise_at = 0
        self._now_us = NEVER_US
        self._next_frame_us = NEVER_US
        self._servos_us = [retracted_us] * 3
        self._goals_us = [retracted_us] * 3
        self._arms_us = [retracted_us] * 3
        self._moving = False
        self._lag_decay_us = 0
        self._lag_decay = 1.0
        self._loaded_n = 0.0
        self._mean_counts = 0.0
        self._counts = 0
        linkage, servo = settings.linkage, settings.servo
        self._half_play_us = 0.5 * servo.backlash_deg * linkage.us_per_degree
        self._rate = servo.rate_deg_s * linkage.us_per_degree * 1e-6  # µs of pulse per µs
        self._slow_us = self._rate * servo.lag_s * 1e6  # nearer than this the lag is slower than the limit
        self._radians_per_us = math.pi / 180.0 / linkage.us_per_degree
        self._lowest = math.sin((linkage.retracted_us - linkage.level_us) * self._radians_per_us)
        self._stall_n = 3.0 * settings.servo.stall_nm / settings.linkage.arm_m
        self._full_scale = (1 << settings.sensor.adc_bits) - 1
        self._finger = settings.finger
        self.contact_force_n = 0.0
        self.displacement_m = 0.0
        self.latched_us: Pulses = (retracted_us, retracted_us, retracted_us)
        self._handed_us = self.latched_us

    def step(self, pulses_us: Pulses, now_us: int) -> int:
        """Advance to `now_us` [µs], hand over new pulse widths [µs], and return the converter's counts.

        A frame that began since the last call took the pulses handed over then; one that begins now takes these. A
        repeated or earlier time advances nothing, and the clock goes on from there.
        """
        if now_us <= self._now_us:
            if now_us < self._now_us:
                frame_us = self._settings.servo.frame_us
                self._now_us = now_us
                self._next_frame_us = now_us - now_us % frame_us + frame_us
            self._handed_us = pulses_us
            return self._counts
        if now_us >= self._next_frame_us:
            self._cross_frames(pulses_us, now_us)
        elif self._moving:
            self._move(now_us - self._now_us)
        self._now_us = now_us
        self._handed_us = pulses_us
        return self._convert()

    def exchange_finger(self, finger: Finger) -> None:
        """Put another finger under the platform, as when it stiffens or is withdrawn in the middle of a run."""
        self._finger = finger
        self._press()

    def _cross_frames(self, pulses_us: Pulses, now_us: int) -> None:
        frame_us = self._settings.servo.frame_us
        edge_us = self._next_frame_us
        last_edge_us = now_us - now_us % frame_us
        self._move(edge_us - self._now_us)
        # Latching the same pulses again at later frames changes nothing, so a long gap is one motion.
        self._latch(pulses_us if edge_us == now_us else self._handed_us)
        if edge_us < now_us:
            self._move(now_us - edge_us)
        if edge_us < last_edge_us == now_us:
            self._latch(pulses_us)
        self._next_frame_us = last_edge_us + frame_us

    def _latch(self, pulses_us: Pulses) -> None:
        deadband_us = self._settings.servo.deadband_us
        self.latched_us = pulses_us
        for i, pulse_us in enumerate(pulses_us):
            if abs(pulse_us - self._goals_us[i]) >= deadband_us or abs(pulse_us - self._servos_us[i]) >= deadband_us:
                self._goals_us[i] = pulse_us
                self._moving = True

    def _move(self, elapsed_us: int) -> None:
        settings = self._settings
        lag_s = settings.servo.lag_s
        if elapsed_us != self._lag_decay_us:
            self._lag_decay_us = elapsed_us
            self._lag_decay = math.exp(-elapsed_us * 1e-6 / lag_s)
        half_play_us, rate, slow_us = self._half_play_us, self._rate, self._slow_us
        level_us, radians_per_us = settings.linkage.level_us, self._radians_per_us
        moving = False
        height = 0.0
        for i in range(3):
            servo_us = self._servos_us[i]
            error_us = self._goals_us[i] - servo_us
            if error_us:
                distance_us = abs(error_us)
                if distance_us <= slow_us:
                    distance_us *= self._lag_decay
                elif distance_us - slow_us >= rate * elapsed_us:
                    distance_us -= rate * elapsed_us
                else:
                    coasting_us = elapsed_us - (distance_us - slow_us) / rate
                    distance_us = slow_us * math.exp(-coasting_us * 1e-6 / lag_s)
                if distance_us < AT_REST_US:
                    servo_us = self._goals_us[i]
                else:
                    servo_us = self._goals_us[i] - math.copysign(distance_us, error_us)
                    moving = True
                self._servos_us[i] = servo_us
                arm_us = self._arms_us[i]
                if arm_us < servo_us - half_play_us:
                    self._arms_us[i] = servo_us - half_play_us
                elif arm_us > servo_us + half_play_us:
                    self._arms_us[i] = servo_us + half_play_us
            height += math.sin((self._arms_us[i] - level_us) * radians_per_us)
        self._moving = moving
        self.displacement_m = settings.linkage.arm_m * (height / 3.0 - self._lowest)
        self._press()

    def _press(self) -> None:
        force_n = self.contact_force_n = min(self._finger.force_n(self.displacement_m), self._stall_n)
        sensor = self._settings.sensor
        # A play operator whose gap grows with the load: loading goes along its lower edge, unloading along the upper.
        self._loaded_n = min(max(self._loaded_n, force_n), force_n * sensor.unloading_gain)
        self._mean_counts = sensor.counts(self._loaded_n)

    def _convert(self) -> int:
        mean = self._mean_counts
        if mean <= 0.0:
            self._counts = 0
            return 0
        at = self._noise_at
        if at == len(self._noise):
            self._noise = self._rng.normal(0.0, self._settings.sensor.noise_counts, NOISE_BLOCK).tolist()
            at = 0
        self._noise_at = at + 1
        self._counts = min(max(int(mean + self._noise[at]), 0), self._full_scale)
        return self._counts
