"""From platform displacement to three servo pulses, and back.

Three servos stand around the platform, each lifting one corner with a short arm; the mean of the three heights is how
far the platform presses the fingertip, their differences only tilt it. A servo ignores a pulse that is nearer than
its deadband to the one it holds, so moved together the three can go in steps of a deadband only. Moved one at a time,
always the one that lags most, their mean goes in steps of a third of it.
"""

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.hardware import SERVO_DEADBAND_US

Pulses: TypeAlias = tuple[float, float, float]

ROUNDING: Final = 0.53
"""Share of a deadband that must be missing before one servo moves by a whole one.

A half would put the mean nearest to its goal, but then noise alone would send the servo forth and back.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Linkage:
    """How servo pulses lift the platform.

    Attributes
    ----------
    arm_m
        Length of each servo's arm [m]; 12 mm in the paper's device.
    us_per_degree
        Pulse [µs] per degree of rotation; 10 is typical of the HS-55 (600 to 2400 µs over 180°).
    level_us
        Pulse [µs] at which the arms stand at right angles to the platform's way.
    retracted_us
        Pulse [µs] at displacement 0. An assumption: 30° below level leaves room for a finger to slip in.
    extended_us
        Pulse [µs] at full travel. An assumption: 50° above level, what any hobby servo reaches safely.
    timer_step_us
        Resolution of a pulse [µs]: Timer1 of the ATmega328P at 16 MHz / 8.
    deadband_us
        Change of pulse [µs] below which a servo does not stir; 8 is typical of the HS-55.

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
            raise SettingsError("the extended pulse must be longer than the retracted one; both are the same")

    @property
    def travel_m(self) -> float:
        """How far the platform goes from retracted to extended [m]."""
        return self.displacement_m(self.extended_us)

    def displacement_m(self, pulse_us: float) -> float:
        """Return the height [m] above retracted to which one servo at `pulse_us` [µs] lifts its corner."""
        radians_per_us = math.pi / 180.0 / self.us_per_degree
        return self.arm_m * (
            math.sin((pulse_us - self.level_us) * radians_per_us)
            - math.sin((self.retracted_us - self.level_us) * radians_per_us)
        )

    def pulse_us(self, displacement_m: float) -> float:
        """Return the exact pulse [µs] for a displacement [m], clamped to the travel; retracted if not finite."""
        if not 0.0 < displacement_m < math.inf:
            return self.retracted_us
        us_per_radian = 180.0 / math.pi * self.us_per_degree
        sine = displacement_m / self.arm_m + math.sin((self.retracted_us - self.level_us) / us_per_radian)
        if sine >= 1.0:
            return self.extended_us
        return min(self.level_us + us_per_radian * math.asin(sine), self.extended_us)

    def pulses_us(self, displacement_m: float, held_us: Pulses) -> Pulses:
        """Return the three pulses [µs] that bring the servos' mean as near to a displacement [m] as they can.

        Every servo keeps the pulse it holds or gets one at least a deadband away, so that what is sent is what the
        servos do. The mean pulse misses its goal by less than a quarter of a deadband, and the servos stay at most two
        deadbands apart: 1.6° of arm, or 0.3 mm across the platform.

        Parameters
        ----------
        displacement_m
            Displacement [m] wanted; clamped to the travel, retracted if not finite.
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
        """Divide a sum of pulses [µs] into whole timer steps, as evenly as they go."""
        each, left_over = divmod(round(total_us / self.timer_step_us), servos)
        return [(each + (i < left_over)) * self.timer_step_us for i in range(servos)]
