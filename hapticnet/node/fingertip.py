"""The path of a force to its device: rendered component, limits, force loop if any, and device."""

import math
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from hapticnet.control.force import ForceController
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import ForceLimiter, LimitSettings
from hapticnet.device.base import Device, Reading
from hapticnet.device.user import UserActuator
from hapticnet.measure.running_error import RunningError
from hapticnet.node.settings import MasterSettings, device_axis
from hapticnet.samples import Vector


@dataclass(frozen=True, slots=True)
class DeviceLost:
    """The device no longer gives readings; `reason` is its status."""

    reason: str


@dataclass(frozen=True, slots=True)
class DeviceFound:
    """The device gives readings, for the first time or again; it starts retracted."""

    description: str


@dataclass(frozen=True, slots=True)
class ForceFault:
    """The force loop keeps the platform retracted; `reason` says why."""

    reason: str


@dataclass(frozen=True, slots=True)
class FingerMet:
    """The finger was touched: the platform's displacement at contact [m] and the finger's stiffness at 1 N [N/m]."""

    contact_m: float
    stiffness_n_m: float


@dataclass(frozen=True, slots=True)
class FingerNotMet:
    """No finger was felt, so the first force searches for it; `reason` says why."""

    reason: str


FingertipEvent: TypeAlias = DeviceLost | DeviceFound | ForceFault | FingerMet | FingerNotMet


class Fingertip:
    """A device and the force loop that drives it. A device that returns after a loss is treated as new."""

    def __init__(self, device: Device, limits: LimitSettings, control: ForceControlSettings) -> None:
        self.device = device
        max_force_n = min(control.max_force_n, device.max_force_n)
        headroom_n = min(control.headroom_n, 0.5 * max_force_n)
        self.largest_n = max_force_n - headroom_n  # largest force requested: leaves room for the overshoot of the loop
        within_device = replace(
            control,
            travel_m=min(control.travel_m, device.travel_m),
            max_force_n=max_force_n,
            headroom_n=headroom_n,
            search_n=min(control.search_n, 0.5 * max_force_n),
            yield_n=min(control.yield_n, 0.5 * max_force_n),
        )
        self.controller = ForceController(within_device)
        self.target_n = 0.0  # force [N] requested of the device, after the limits
        self.displacement_m = 0.0  # platform displacement last requested [m]
        self.reading: Reading | None = None  # the newest reading; None while the device is lost
        # how far ahead [µs] the force is to be predicted, so that the servos reach it in time
        self.lead_us = round(1e6 * within_device.foresight_s) + device.delay_us
        self._rise_n = 1e-6 * limits.slew_n_per_s * self.lead_us
        self._limiter = ForceLimiter(replace(limits, max_force_n=min(limits.max_force_n, self.largest_n)))
        self._found = False
        self._times_lost = 0
        self._fault: str | None = None
        self._events: list[FingertipEvent] = []

    @property
    def sensed_n(self) -> float:
        """Newest sensed force [N]; 0 while the device is lost."""
        return self.reading.force_n if self.reading is not None else 0.0

    @property
    def status(self) -> str:
        """State of the force loop, if it has a fault, or else of the device, in words."""
        return self.controller.fault or self.device.status

    def press(self, force_n: float, now_us: int, ahead_n: float | None = None) -> None:
        """Move the device one step toward a force [N]; `ahead_n`: the force expected `lead_us` from now, if known."""
        reading = self.reading
        if reading is None:
            # Without a device the limiter falls to zero, so the force rises from zero when the device returns.
            self.target_n = self._limiter.limit(0.0, now_us)
            self.displacement_m = 0.0
        else:
            self.target_n = self._limiter.limit(force_n, now_us)
            if ahead_n is not None:
                ahead_n = min(ahead_n, self.target_n + self._rise_n) if math.isfinite(force_n) else 0.0
            self.displacement_m = self.controller.update(
                self.target_n, reading.force_n, reading.displacement_m, now_us, ahead_n=ahead_n
            )
        self.reading = self.device.exchange(self.displacement_m, now_us)
        if (self.reading is not None) != self._found or self.controller.fault != self._fault:
            self._note_changes()

    def report(self) -> dict[str, Any]:
        """Return the report of this fingertip for JSON."""
        finger = self.controller.finger
        return {
            "description": self.device.description,
            "status": self.status,
            "times_lost": self._times_lost,
            "finger_stiffness_n_m": 1.0 / finger.compliance_m_n if finger.felt else None,
            "finger_contact_m": finger.contact_m if finger.felt else None,
            "line": self.device.report(),
        }

    def next_event(self) -> FingertipEvent | None:
        """Return the next event, or None."""
        return self._events.pop(0) if self._events else None

    def _note_changes(self) -> None:
        found = self.reading is not None
        if found != self._found:
            self._found = found
            if found:
                self._events.append(DeviceFound(self.device.description))
            else:
                self._times_lost += 1
                self.controller.reset()
                self._events.append(DeviceLost(self.device.status))
        if self.controller.fault != self._fault:
            self._fault = self.controller.fault
            if self._fault is not None:
                self._events.append(ForceFault(self._fault))


class Actuator:
    """An actuator and the limits of the requested force. Replaces a `Fingertip`."""

    def __init__(self, device: UserActuator, limits: LimitSettings) -> None:
        self.device = device
        self.target_n = self.displacement_m = 0.0  # force [N] requested of the device, after the limits
        self.reading: Reading | None = None  # the newest sensed force; None without a sensor
        self._limiter = ForceLimiter(replace(limits, max_force_n=min(limits.max_force_n, device.max_force_n)))
        self._events: list[FingertipEvent] = [DeviceFound(device.description)]

    @property
    def sensed_n(self) -> float:
        """Newest sensed force [N]; the requested one if the device senses none."""
        return self.reading.force_n if self.reading is not None else self.target_n

    @property
    def status(self) -> str:
        """The device's status."""
        return self.device.status

    def press(self, force_n: float, now_us: int, ahead_n: float | None = None) -> None:  # noqa: ARG002
        """Request a force [N] from the device; called every tick. The device handles its own delay."""
        self.target_n = self._limiter.limit(force_n, now_us)
        sensed_n = self.device.apply(self.target_n, now_us)
        self.reading = None if sensed_n is None else Reading(now_us, 0.0, sensed_n, 0.0)

    def report(self) -> dict[str, Any]:
        """Return the report of this device for JSON."""
        return {"description": self.device.description, "status": self.status, "line": self.device.report()}

    def next_event(self) -> FingertipEvent | None:
        """Return the next event, or None."""
        return self._events.pop(0) if self._events else None


class Rendering:
    """A device with its limits and, if it takes positions, its force loop; or none."""

    def __init__(self, device: Device | UserActuator | Fingertip | None, settings: MasterSettings, axes: int) -> None:
        self.fingertip: Fingertip | Actuator | None  # renders the force; None without a device
        if isinstance(device, UserActuator):
            self.fingertip = Actuator(device, settings.limits)
        elif device is None or isinstance(device, Fingertip):
            self.fingertip = device
        else:
            self.fingertip = Fingertip(device, settings.limits, settings.control)
        self.with_loop = self.fingertip if isinstance(self.fingertip, Fingertip) else None  # with a force loop
        self._axis = device_axis(settings.device_takes, axes) if device is not None else None
        self._axes = axes  # of the part that it renders
        self._tracking = RunningError(settings.law)

    @property
    def what(self) -> str:
        """The device's name in messages."""
        return getattr(self.fingertip and self.fingertip.device, "what", "the device and its force loop")

    @property
    def largest_n(self) -> float:
        """Largest force [N] that the device renders; infinite without one."""
        if self.with_loop is not None:
            return self.with_loop.largest_n
        return self.fingertip.device.max_force_n if isinstance(self.fingertip, Actuator) else math.inf

    @property
    def least_rate_hz(self) -> float:
        """Rate [Hz] below which the device's force loop must not run."""
        return self.with_loop.device.least_rate_hz if self.with_loop is not None else 0.0

    def press(self, held_n: Vector, ahead_n: Vector, now_us: int, *, counts: bool) -> tuple[float, float, float]:
        """Render a force [N]; return force [N] requested and sensed, and displacement [m]. May raise anything."""
        fingertip = self.fingertip
        assert fingertip is not None, "there is a device"  # noqa: S101 - the caller's fault
        rendered_n = self._part(held_n)
        fingertip.press(rendered_n, now_us, rendered_n if ahead_n is held_n else self._part(ahead_n))
        if counts and fingertip.reading is not None:
            self._tracking.add((fingertip.target_n,), (fingertip.sensed_n,))
        return fingertip.target_n, fingertip.sensed_n, fingertip.displacement_m

    def next_event(self) -> FingertipEvent | None:
        """Return the next event, or None."""
        return None if self.fingertip is None else self.fingertip.next_event()

    def report(self) -> dict[str, Any]:
        """Return the report for JSON."""
        tracking = self._tracking.report() if self._tracking.samples else None
        return {
            "device": self.fingertip.report() if self.fingertip else None,
            "tracking_rmse_n": tracking.rmse_n if tracking else None,
            "tracking_max_n": tracking.max_error_n if tracking else None,
        }

    def _part(self, force_n: Vector) -> float:
        """Return the part of a force [N] that the device renders."""
        return math.hypot(*force_n[: self._axes]) if self._axis is None else force_n[self._axis]
