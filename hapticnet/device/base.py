"""What the master sees of a fingertip device, real or simulated."""

from typing import NamedTuple, Protocol


class Reading(NamedTuple):
    """The newest reading of the force sensor.

    Attributes
    ----------
    t_us
        When it was taken [µs], on the master's clock.
    adc
        What the converter gave, in counts.
    force_n
        The same through the device's calibration [N]; 0 below the sensor's threshold.
    """

    t_us: int
    adc: int
    force_n: float


class Device(Protocol):
    """A platform that presses a fingertip.

    Attributes
    ----------
    travel_m
        How far the platform can go toward the finger [m]; 0 is fully retracted.
    max_force_n
        Largest force [N] the device may be asked for.
    description
        One line that tells a person which device this is.
    """

    travel_m: float
    max_force_n: float
    description: str

    def exchange(self, displacement_m: float, now_us: int) -> Reading:
        """Hand over the newest platform displacement [m] and get the newest reading.

        Called every tick. Never blocks and never raises: a displacement outside the travel is clamped, one that is
        not finite retracts.
        """
        ...
