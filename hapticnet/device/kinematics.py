"""Conversion between platform displacement and three servo pulses.

Three servos around the platform each lift one corner with a short arm. The mean of the three heights is the
displacement toward the fingertip; their differences only tilt the platform. A servo ignores a pulse within its deadband
of the one it holds, so three servos moved together have a resolution of one deadband. Moved one at a time, always the
one furthest behind, they have a resolution of a third of it.
"""

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.hardware import SERVO_DEADBAND_US

Pulses: TypeAlias = tuple[float, float, float]

ROUNDING: Final = 0.53
"""Smallest error of the mean, as a share of a deadband, at which one servo moves by a whole deadband.

At one half the mean would be nearest to its goal, but noise alone would make the servo oscillate.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Linkage:
    """Geometry and pulses of the servos.

    Attributes
    ----------
    arm_m
        Length of a servo's arm [m]; 12 mm in the paper's device.
    us_per_degree
        Pulse [µs] per degree of rotation; 10 is typical of the HS-55 (600 to 2400 µs over 180°).
    level_us
        Pulse [µs] at which the arms are perpendicular to the motion of the platform.
    retracted_us
        Pulse [µs] at displacement 0. An assumption: 30° below level leaves room to insert a finger.
    extended_us
        Pulse [µs] at full travel. An assumption: any hobby servo reaches 50° above level safely.
    timer_step_us
        Resolution of a pulse [µs]: Timer1 of the ATmega328P at 16 MHz / 8.
    deadband_us
        Change of pulse [µs] below which a servo does not move.

    Raises
    ------
    SettingsError
        If a value is not finite or the pulses are not in order.
    """

    arm_m: float = 0.012
    us_per_degree: float = 10.0
    level_us: float = 1500.0
    retracted_us: float = 1200.0
    extended_us: float = 2000.0
    timer_step_us: float = 0.5
    deadband_us: float = SERVO_DEADBAND_US

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

        Every servo keeps its pulse or gets one at least a deadband away, so that each servo follows what it is sent.
        The error of the mean pulse is below a quarter of a deadband, and the servos stay within two deadbands of each
        other: 1.6° of arm, or 0.3 mm across the platform.

        Parameters
        ----------
        displacement_m
            Displacement [m]; clamped to the travel, retracted if it is not finite.
        held_us
            Pulses [µs] the servos took at their last frame.
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
