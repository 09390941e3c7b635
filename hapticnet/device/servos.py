"""Three servos: from the pulses they take to the height of the platform they lift."""

import math
from typing import Final

from hapticnet.device.kinematics import Linkage, Pulses
from hapticnet.device.parts import Servo

AT_REST_US: Final = 0.01
"""A servo this near its goal [µs of pulse] is there: 0.2 µm of platform."""


class Servos:
    """The motion of three servos and their arms.

    A servo follows a pulse that is at least its deadband away from where it stands or from where it is heading, as a
    first-order lag whose speed is limited, and its arm follows through the gears' backlash. Between pulses the motion
    is a closed form, so the steps' size does not matter.

    Backlash is a play operator, as if friction held the arm: pessimistic, because a pressed finger loads the gears to
    one side. Without backlash this is the best a host can know of a platform it does not see.

    Attributes
    ----------
    taken_us
        The pulses [µs] the servos took last.
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
        self._slow_us = self._rate * servo.lag_s * 1e6  # nearer than this the lag is slower than the limit
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
        """The pulses [µs] the servos have accepted; one nearer than the deadband to that was not."""
        one, two, three = self._goals_us
        return one, two, three

    def take(self, pulses_us: Pulses) -> None:
        """Take one pulse [µs] each: a frame."""
        # A servo that stands has long decided about the pulse it is given again.
        if self._moving or pulses_us != self.taken_us:
            for index, pulse_us in enumerate(pulses_us):
                self._head_for(index, pulse_us)
            self.taken_us = pulses_us

    def take_one(self, index: int, pulse_us: float) -> None:
        """Take the pulse [µs] of one servo (0 to 2)."""
        one, two, three = self.taken_us
        self.taken_us = (
            (pulse_us, two, three) if index == 0 else (one, pulse_us, three) if index == 1 else (one, two, pulse_us)
        )
        self._head_for(index, pulse_us)

    def move(self, elapsed_us: float) -> bool:
        """Let time [µs] pass; tell whether any servo moved."""
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
        """Return how far [µs of pulse] is left of a way that begins at the speed limit and may end in the lag."""
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
