"""What the master sees of a fingertip device, real or simulated."""

from typing import Any, NamedTuple, Protocol


class Reading(NamedTuple):
    """The newest reading of the force sensor.

    Attributes
    ----------
    t_us
        When it was taken [µs], on the master's clock.
    adc
        What the converter gave, in counts; a device that averages gives fractions of one.
    force_n
        The same through the device's calibration [N]; 0 below the sensor's threshold.
    displacement_m
        Where the platform stands [m above retracted], as far as anyone can tell from the pulses its servos took:
        their lag is known, their backlash is not.
    """

    t_us: int
    adc: float
    force_n: float
    displacement_m: float


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
    status
        What a person should know of it now: "ready", or why there are no readings.
    """

    travel_m: float
    max_force_n: float
    description: str
    status: str

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Hand over the newest platform displacement [m] and get the newest reading; None while the device is lost.

        Called every tick. Never blocks and never raises: a displacement outside the travel is clamped, one that is
        not finite retracts. A device that was lost comes back retracted.
        """
        ...

    @property
    def contact_force_n(self) -> float | None:
        """True force [N] on the finger, which only a simulated device knows."""
        return None

    def report(self) -> dict[str, Any]:
        """Return what this kind of device has to say of itself for JSON, beyond its description and status."""
        return {}
