"""Three servos: from pulses to the height of the platform."""

import math
from typing import Final

from hapticnet.device.kinematics import Linkage, Pulses
from hapticnet.device.parts import Servo

AT_REST_US: Final = 0.01
"""Distance from the goal [µs of pulse] at which a servo counts as arrived: 0.2 µm of platform."""


class Servos:
    """Motion of three servos and their arms.

    A servo follows a pulse that differs by at least its deadband from its position or from its goal. It moves as a
    first-order lag with limited speed; its arm follows through the gears' backlash. Between pulses the motion has a
    closed form, so the step size does not matter.

    Backlash is a play operator, as if friction held the arm. This is pessimistic, because a pressed finger loads the
    gears to one side. Without backlash, the model is the best estimate a host can make of an unobserved platform.

    Attributes
    ----------
    taken_us
        The pulses [µs] the servos received last.
    displacement_m
        Mean height [m] of the three arms above retracted.
    """

    __slots__ = (
        "_arm_m", "_arms_us", "_deadband_us", "_decay", "_decay_us", "_goals_us", "_half_play_us", "_lag_s",
        "_level_us", "_lowest", "_moving", "_radians_per_us", "_rate", "_servos_us", "_sines", "_slow_us",
        "displacement_m", "taken_us",
    )  # fmt: skip

    def __init__(self, linkage: Linkage, servo: Servo) -> None:
        self._arm_m = linkage.arm_m
        self._level_us = linkage.level_us
        self._radians_per_us = math.pi / 180.0 / linkage.us_per_degree
        self._lowest = math.sin((linkage.retracted_us - linkage.level_us) * self._radians_per_us)
        self._deadband_us = servo.deadband_us
        self._half_play_us = 0.5 * servo.backlash_deg * linkage.us_per_degree
        self._lag_s = servo.lag_s
        self._rate = servo.rate_deg_s * linkage.us_per_degree * 1e-6  # µs of pulse per µs
        self._slow_us = self._rate * servo.lag_s * 1e6  # below this distance the lag is slower than the speed limit
        self._decay_us = 0.0
        self._decay = 1.0
        pulse_us = linkage.retracted_us
        self.taken_us: Pulses = (pulse_us, pulse_us, pulse_us)
        self._servos_us = [pulse_us] * 3
        self._goals_us = [pulse_us] * 3
        self._arms_us = [pulse_us] * 3
        self._sines = [self._lowest] * 3
        self._moving = False
        self._lift()

    @property
    def heading_us(self) -> Pulses:
        """The pulses [µs] the servos move to; a received pulse within the deadband does not change them."""
        one, two, three = self._goals_us
        return one, two, three

    def take(self, pulses_us: Pulses) -> None:
        """Give each servo a pulse [µs]: one frame."""
        # A servo at rest ignores a repeated pulse.
        if self._moving or pulses_us != self.taken_us:
            for index, pulse_us in enumerate(pulses_us):
                self._head_for(index, pulse_us)
            self.taken_us = pulses_us

    def take_one(self, index: int, pulse_us: float) -> None:
        """Give one servo (0 to 2) a pulse [µs]."""
        one, two, three = self.taken_us
        self.taken_us = (
            (pulse_us, two, three) if index == 0 else (one, pulse_us, three) if index == 1 else (one, two, pulse_us)
        )
        self._head_for(index, pulse_us)

    def move(self, elapsed_us: float) -> bool:
        """Advance time by `elapsed_us` [µs]; return whether any servo moved."""
        if not self._moving or elapsed_us <= 0.0:
            return False
        if elapsed_us != self._decay_us:
            self._decay_us = elapsed_us
            self._decay = math.exp(-elapsed_us * 1e-6 / self._lag_s)
        servos_us, arms_us, half_play_us = self._servos_us, self._arms_us, self._half_play_us
        moving = False
        for index, goal_us in enumerate(self._goals_us):
            error_us = goal_us - servos_us[index]
            if not error_us:
                continue
            left_us = error_us if error_us > 0.0 else -error_us
            left_us = left_us * self._decay if left_us <= self._slow_us else self._rate_limited_us(left_us, elapsed_us)
            if left_us < AT_REST_US:
                servo_us = goal_us
            else:
                servo_us = goal_us - left_us if error_us > 0.0 else goal_us + left_us
                moving = True
            servos_us[index] = servo_us
            arm_us = arms_us[index]
            if arm_us < servo_us - half_play_us:
                arm_us = servo_us - half_play_us
            elif arm_us > servo_us + half_play_us:
                arm_us = servo_us + half_play_us
            else:
                continue
            arms_us[index] = arm_us
            self._sines[index] = math.sin((arm_us - self._level_us) * self._radians_per_us)
        self._moving = moving
        self._lift()
        return True

    def _rate_limited_us(self, distance_us: float, elapsed_us: float) -> float:
        """Return the remaining distance [µs of pulse] of a motion that starts at the speed limit."""
        fast_us = distance_us - self._slow_us
        if fast_us >= self._rate * elapsed_us:
            return distance_us - self._rate * elapsed_us
        return self._slow_us * math.exp(-(elapsed_us - fast_us / self._rate) * 1e-6 / self._lag_s)

    def _head_for(self, index: int, pulse_us: float) -> None:
        deadband_us = self._deadband_us
        if (
            abs(pulse_us - self._goals_us[index]) >= deadband_us
            or abs(pulse_us - self._servos_us[index]) >= deadband_us
        ):
            self._goals_us[index] = pulse_us
            self._moving = True

    def _lift(self) -> None:
        one, two, three = self._sines
        self.displacement_m = self._arm_m * ((one + two + three) / 3.0 - self._lowest)
