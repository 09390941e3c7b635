"""How the force that a master holds reaches its device, and how well the device follows."""

import math
from typing import Any, NamedTuple

from hapticnet.device.base import Device
from hapticnet.device.user import UserActuator
from hapticnet.measure.metrics import RunningError
from hapticnet.node.actuator import Actuator
from hapticnet.node.fingertip import Fingertip, FingertipEvent
from hapticnet.node.master_settings import MasterSettings, device_axis
from hapticnet.samples import Vector


class Felt(NamedTuple):
    """Force [N] requested of the device and sensed by it, and the displacement [m] of its platform."""

    target_n: float
    sensed_n: float
    displacement_m: float


class Rendering:
    """A device with its limits and, if it takes positions, its force loop; or none.

    Attributes
    ----------
    fingertip
        What renders the force; None without a device.
    with_loop
        The same if there is a force loop.
    """

    def __init__(self, device: Device | UserActuator | Fingertip | None, settings: MasterSettings, axes: int) -> None:
        self.fingertip: Fingertip | Actuator | None
        if isinstance(device, UserActuator):
            self.fingertip = Actuator(device, settings.limits)
        elif device is None or isinstance(device, Fingertip):
            self.fingertip = device
        else:
            self.fingertip = Fingertip(device, settings.limits, settings.control)
        self.with_loop = self.fingertip if isinstance(self.fingertip, Fingertip) else None
        self._axis = device_axis(settings.device_takes, axes) if device is not None else None
        self._tracking = RunningError(settings.law)

    @property
    def what(self) -> str:
        """What messages call the device."""
        return getattr(self.fingertip and self.fingertip.device, "what", "the device and its force loop")

    @property
    def least_rate_hz(self) -> float:
        """Rate [Hz] below which the device's force loop must not run."""
        return self.with_loop.device.least_rate_hz if self.with_loop is not None else 0.0

    def press(self, held_n: Vector, ahead_n: Vector, now_us: int, *, counts: bool) -> Felt:
        """Render a force [N]; what drives a device may raise anything.

        Parameters
        ----------
        ahead_n
            The force expected by the time the device will have moved.
        counts
            Whether the error of the device counts for the report.
        """
        fingertip = self.fingertip
        assert fingertip is not None, "there is a device"  # noqa: S101 - the caller's fault
        rendered_n = self._part(held_n)
        fingertip.press(rendered_n, now_us, rendered_n if ahead_n is held_n else self._part(ahead_n))
        if counts and fingertip.reading is not None:
            self._tracking.add((fingertip.target_n,), (fingertip.sensed_n,))
        return Felt(fingertip.target_n, fingertip.sensed_n, fingertip.displacement_m)

    def next_event(self) -> FingertipEvent | None:
        """Return the next event, or None."""
        return None if self.fingertip is None else self.fingertip.next_event()

    def report(self) -> dict[str, Any]:
        """Return the account for JSON."""
        tracking = self._tracking.report() if self._tracking.samples else None
        return {
            "device": self.fingertip.report() if self.fingertip else None,
            "tracking_rmse_n": tracking.rmse_n if tracking else None,
            "tracking_max_n": tracking.max_error_n if tracking else None,
        }

    def _part(self, force_n: Vector) -> float:
        """Return the part of a force [N] that the device renders."""
        return math.hypot(*force_n) if self._axis is None else force_n[self._axis]
