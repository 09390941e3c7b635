"""The interface of a fingertip device, real or simulated."""

from typing import Any, Final, NamedTuple, Protocol

from hapticnet.capabilities import Capabilities
from hapticnet.hardware import MAX_FORCE_N, SLEW_N_PER_S

FORCE_LOOP_HZ: Final = 1000.0
"""Least rate [Hz] of the force loop. Its limits are made for a target that moves this often: at 31 Hz a square wave of
1 to 5 N presses a finger of 3 N/mm with 5.2 N; at 1 kHz, bench/measure/hostile_slave.py finds nothing above 4.8 N."""


def presses(travel_m: float, max_force_n: float = MAX_FORCE_N) -> Capabilities:
    """Return the capabilities of a fingertip device with a travel [m], limited as the paper's unless it says less."""
    return Capabilities(travel_m=travel_m, max_force_n=max_force_n, slew_n_per_s=SLEW_N_PER_S)


class Reading(NamedTuple):
    """The newest reading of the force sensor."""

    t_us: int  # time [µs] of the reading, on the master's clock
    adc: float  # output of the converter [counts]; averages may have a fraction
    force_n: float  # calibrated force [N]; 0 below the sensor's threshold
    displacement_m: float  # estimate [m above retracted] from the pulses that the servos took, without backlash


class Device(Protocol):
    """A platform that presses a fingertip."""

    capabilities: Capabilities  # its travel is the largest displacement [m] of the platform; 0 is fully retracted
    description: str  # one line that identifies the device to a person
    status: str  # the word "ready", or the reason why there are no readings
    delay_us: int = 0  # time [µs] from a call until the servos take its displacement, plus the wait for their frame
    least_rate_hz: float = FORCE_LOOP_HZ  # least rate [Hz] at which it is driven, whatever the rate of the session

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Set the platform displacement [m] and return the newest reading, or None while the device is lost.

        Called every tick. It never blocks and never raises. A displacement outside the travel is clamped; one that is
        not finite retracts the platform. A device that was lost comes back retracted.
        """
        ...

    @property
    def contact_force_n(self) -> float | None:
        """True force [N] on the finger, known only to simulated devices."""
        return None

    def report(self) -> dict[str, Any]:
        """Return further information about this kind of device as a JSON object."""
        return {}
