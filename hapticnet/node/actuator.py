"""A device that renders a force by itself: limits and device, without a force loop."""

from dataclasses import replace
from typing import Any

from hapticnet.control.hold import ForceLimiter, LimitSettings
from hapticnet.device.base import Reading
from hapticnet.device.user import UserActuator
from hapticnet.node.fingertip import DeviceFound, FingertipEvent


class Actuator:
    """An actuator and the limits of what is asked of it. Takes the place of a `Fingertip`.

    Attributes
    ----------
    device
        The actuator.
    target_n
        Force [N] requested of the device, after the limits.
    displacement_m
        0: an actuator has no platform.
    reading
        The newest force that it sensed; None if it senses none.
    """

    __slots__ = ("_events", "_limiter", "device", "displacement_m", "reading", "target_n")

    def __init__(self, device: UserActuator, limits: LimitSettings) -> None:
        self.device = device
        self.target_n = self.displacement_m = 0.0
        self.reading: Reading | None = None
        self._limiter = ForceLimiter(replace(limits, max_force_n=min(limits.max_force_n, device.max_force_n)))
        self._events: list[FingertipEvent] = [DeviceFound(device.description)]

    @property
    def sensed_n(self) -> float:
        """Newest sensed force [N]; the requested one if the device senses none."""
        return self.reading.force_n if self.reading is not None else self.target_n

    @property
    def status(self) -> str:
        """What the device says of itself."""
        return self.device.status

    def press(self, force_n: float, now_us: int, ahead_n: float | None = None) -> None:  # noqa: ARG002
        """Ask the device for a force [N]; called every tick. What it does about its own delay is its own matter."""
        self.target_n = self._limiter.limit(force_n, now_us)
        sensed_n = self.device.apply(self.target_n, now_us)
        self.reading = None if sensed_n is None else Reading(now_us, 0.0, sensed_n, 0.0)

    def report(self) -> dict[str, Any]:
        """Return the account of this device for JSON."""
        return {"description": self.device.description, "status": self.status, "line": self.device.report()}

    def next_event(self) -> FingertipEvent | None:
        """Return the next event, or None."""
        return self._events.pop(0) if self._events else None
