"""Three servos: from the displacement of the platform to pulses, and from pulses to its height."""

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.hardware import SERVO_DEADBAND_US, SERVO_FRAME_US, SERVO_LAG_S

Pulses: TypeAlias = tuple[float, float, float]
ROUNDING: Final = 0.53
"""Smallest error of the mean, as a share of a deadband, at which one servo moves by a whole deadband: at one half the
mean would be nearest to its goal, but noise alone would make the servo oscillate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Linkage:
    """Geometry and pulses of the servos; SettingsError if a value is not finite or the pulses are not in order."""

    arm_m: float = 0.012  # length of a servo's arm [m]; 12 mm in the paper's device
    us_per_degree: float = 10.0  # pulse [µs] per degree of rotation; typical of the HS-55 (600 to 2400 µs over 180°)
    level_us: float = 1500.0  # pulse [µs] at which the arms are perpendicular to the motion of the platform
    retracted_us: float = 1200.0  # pulse [µs] at displacement 0; assumed: 30° below level leaves room for a finger
    extended_us: float = 2000.0  # pulse [µs] at full travel; assumed: any hobby servo reaches 50° above level
    timer_step_us: float = 0.5  # resolution of a pulse [µs]: Timer1 of the ATmega328P at 16 MHz / 8
    deadband_us: float = SERVO_DEADBAND_US  # change of pulse [µs] below which a servo does not move

    def __post_init__(self) -> None:
        check_parameter("arm length", self.arm_m, 1e-3, 0.1, "m")
        check_parameter("pulse per degree", self.us_per_degree, 1.0, 100.0, "µs")
        check_parameter("level pulse", self.level_us, 500.0, 2500.0, "µs")
        check_parameter("retracted pulse", self.retracted_us, 500.0, self.extended_us, "µs")
        check_parameter("extended pulse", self.extended_us, self.retracted_us, 2500.0, "µs")
        check_parameter("timer step", self.timer_step_us, 0.01, 10.0, "µs")
        check_parameter("servo deadband", self.deadband_us, 0.0, 50.0, "µs")
        for name, pulse_us in (("retracted", self.retracted_us), ("extended", self.extended_us)):
            if abs(pulse_us - self.level_us) > 80.0 * self.us_per_degree:
                raise SettingsError(
                    f"{name} pulse is {pulse_us} µs, "
                    f"{abs(pulse_us - self.level_us) / self.us_per_degree:g}° from level; 80° at most"
                )
        if self.travel_m <= 0.0:
            raise SettingsError(
                f"the retracted and the extended pulse are both {self.extended_us} µs; they must differ"
            )

    @property
    def travel_m(self) -> float:
        """Displacement [m] from retracted to extended."""
        return self.displacement_m(self.extended_us)

    def displacement_m(self, pulse_us: float) -> float:
        """Return the height [m] above retracted to which one servo at `pulse_us` [µs] lifts its corner."""
        radians_per_us = math.pi / 180.0 / self.us_per_degree
        return self.arm_m * (
            math.sin((pulse_us - self.level_us) * radians_per_us)
            - math.sin((self.retracted_us - self.level_us) * radians_per_us)
        )

    def pulse_us(self, displacement_m: float) -> float:
        """Return the exact pulse [µs] for a displacement [m], clamped to the travel; retracted if it is not finite."""
        if not 0.0 < displacement_m < math.inf:
            return self.retracted_us
        us_per_radian = 180.0 / math.pi * self.us_per_degree
        sine = displacement_m / self.arm_m + math.sin((self.retracted_us - self.level_us) / us_per_radian)
        if sine >= 1.0:
            return self.extended_us
        return min(self.level_us + us_per_radian * math.asin(sine), self.extended_us)

    def pulses_us(self, displacement_m: float, held_us: Pulses) -> Pulses:
        """Return the three pulses [µs] that bring the servos' mean as near to a displacement [m] as possible.

        Every servo keeps its pulse or gets one at least a deadband away, so that each servo follows its pulse.
        The error of the mean pulse is below a quarter of a deadband, and the servos stay within two deadbands of each
        other: 1.6° of arm, or 0.3 mm across the platform.

        The displacement is clamped to the travel, and retracted if it is not finite.
        """
        step_us = self.timer_step_us
        deadband_us = max(self.deadband_us, step_us)
        goal_us = self.pulse_us(displacement_m)
        missing_us = 3.0 * goal_us - sum(held_us)
        if abs(missing_us) < ROUNDING * deadband_us:
            return held_us
        movers = min(max(int(abs(missing_us) / deadband_us), 1), 3)
        if movers == 3:
            level_us = self._shared_us(3.0 * goal_us, 3)
            if all(abs(level_us[i] - held_us[i]) >= deadband_us for i in range(3)):
                return (level_us[0], level_us[1], level_us[2])
        direction = math.copysign(1.0, missing_us)
        pulses_us = list(held_us)
        most_behind = sorted(range(3), key=lambda i: direction * held_us[i])
        for i, share_us in zip(most_behind, self._shared_us(abs(missing_us), movers), strict=False):
            pulses_us[i] += direction * max(share_us, step_us * math.ceil(deadband_us / step_us))
        return (pulses_us[0], pulses_us[1], pulses_us[2])

    def _shared_us(self, total_us: float, servos: int) -> list[float]:
        """Divide a sum of pulses [µs] into whole timer steps, as evenly as possible."""
        each, left_over = divmod(round(total_us / self.timer_step_us), servos)
        return [(each + (i < left_over)) * self.timer_step_us for i in range(servos)]


AT_REST_US: Final = 0.01  # distance from the goal [µs of pulse] at which a servo counts as arrived: 0.2 µm of platform


@dataclass(frozen=True, slots=True, kw_only=True)
class Servo:
    """An HS-55 hobby servo."""

    frame_us: int = SERVO_FRAME_US  # period [µs] at which it takes a new pulse
    deadband_us: float = SERVO_DEADBAND_US  # change of pulse [µs] below which it does not move
    lag_s: float = SERVO_LAG_S  # time constant [s] of its first-order lag
    rate_deg_s: float = 353.0  # largest speed [deg/s]: 60° in 0.17 s at 4.8 V, HS-55 data sheet
    backlash_deg: float = 0.5  # play of the gears [deg] at the arm; 0.5 is typical of plastic gears
    stall_nm: float = 0.108  # stall torque [N·m]; 0.108 at 4.8 V is typical

    def __post_init__(self) -> None:
        check_parameter("servo frame", self.frame_us, 1_000, 100_000, "µs")
        check_parameter("servo deadband", self.deadband_us, 0.0, 50.0, "µs")
        check_parameter("servo lag", self.lag_s, 1e-4, 1.0, "s")
        check_parameter("servo speed limit", self.rate_deg_s, 1.0, 1e5, "deg/s")
        check_parameter("servo backlash", self.backlash_deg, 0.0, 10.0, "deg")
        check_parameter("servo stall torque", self.stall_nm, 1e-4, 10.0, "N·m")


class Servos:
    """Motion of three servos and their arms.

    A servo follows a pulse that differs by at least its deadband from its position or from its goal. It moves as a
    first-order lag with limited speed; its arm follows through the gears' backlash. Between pulses the motion has a
    closed form, so the step size does not matter.

    Backlash is a play operator, as if friction held the arm. This is pessimistic, because a pressed finger loads the
    gears to one side. Without backlash, the model is the best estimate a host can make of an unobserved platform.
    `displacement_m` is the mean height [m] of the three arms above retracted.
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
        self.taken_us: Pulses = (pulse_us, pulse_us, pulse_us)  # the pulses [µs] the servos received last
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
