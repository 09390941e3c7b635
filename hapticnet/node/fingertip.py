"""The path of a force to its device: rendered component, limits, force loop if any, and device."""

import math
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

from hapticnet.capabilities import Capabilities
from hapticnet.control.force import ForceController
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import LONGEST_STEP_US, PAUSE_US, ForceLimiter
from hapticnet.device.base import Device, Reading
from hapticnet.device.user import UserActuator
from hapticnet.measure.running_error import RunningError
from hapticnet.node.settings import MasterSettings, device_axes
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


MAY_SWING: Final = "this device pushes the hand, and a late force can make it swing: try --coupling energy-bounded"

FingertipEvent: TypeAlias = DeviceLost | DeviceFound | ForceFault | FingerMet | FingerNotMet


class Fingertip:
    """A device and the force loop that drives it. A device that returns after a loss is treated as new."""

    def __init__(self, device: Device, control: ForceControlSettings) -> None:
        self.device = device
        has = device.capabilities
        max_force_n = min(control.max_force_n, has.max_force_n)
        headroom_n = min(control.headroom_n, 0.5 * max_force_n)
        self.largest_n = max_force_n - headroom_n  # largest force requested: leaves room for the overshoot of the loop
        within_device = replace(
            control,
            travel_m=min(control.travel_m, has.travel_m),
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
        self._rise_n = 1e-6 * has.slew_n_per_s * self.lead_us
        self._limiter = ForceLimiter(self.largest_n, has.slew_n_per_s)
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
            "capabilities": self.device.capabilities.report(),
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
    """An actuator and the limits of the requested force. Replaces a `Fingertip`, for forces on one axis or several."""

    def __init__(self, device: UserActuator) -> None:
        self.device = device
        self.target_n = self.displacement_m = 0.0  # force [N] requested of the device, after the limits
        self.reading: Reading | None = None  # the newest sensed force; None without a sensor
        has = device.capabilities
        self.largest_n = has.max_force_n  # largest force requested
        self._zero_n: Vector = (0.0,) * has.axes
        self._period_us = 1e6 / has.rate_hz
        self._applied_n: Vector = self._zero_n
        self._pressed_us: int | None = None  # the last call, and the last one that the device took
        self._taken_us: int | None = None
        self._rests = True
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
        """Request a force [N] on one axis from the device; called every tick. The device handles its own delay."""
        self.render((force_n,), now_us)

    def render(self, force_n: Vector, now_us: int) -> None:
        """Request a force [N] on the axes of the device, the nearest within its limits, when it takes a new one."""
        has = self.device.capabilities
        elapsed_us = 0 if self._pressed_us is None else max(0, now_us - self._pressed_us)
        self._pressed_us = now_us
        if elapsed_us >= PAUSE_US:
            self._applied_n, elapsed_us = self._zero_n, 0
        if len(force_n) == 1 and not has.grounded:
            force_n = (max(0.0, force_n[0]),)
        self._applied_n = has.limited(force_n, self._applied_n, min(elapsed_us, LONGEST_STEP_US))
        rests = self._applied_n == self._zero_n
        soon = self._taken_us is not None and 0 <= now_us - self._taken_us < self._period_us - 0.5
        if soon and not (rests and not self._rests):  # zero does not wait
            return
        self._taken_us, self._rests = now_us, rests
        self.target_n = _size(self._applied_n)
        sensed_n = self.device.apply(self._applied_n, now_us)
        self.reading = None if sensed_n is None else Reading(now_us, 0.0, _size(sensed_n), 0.0)

    def report(self) -> dict[str, Any]:
        """Return the report of this device for JSON."""
        return {
            "description": self.device.description,
            "capabilities": self.device.capabilities.report(),
            "status": self.status,
            "line": self.device.report(),
        }

    def next_event(self) -> FingertipEvent | None:
        """Return the next event, or None."""
        return self._events.pop(0) if self._events else None


def _size(force_n: Vector) -> float:
    """Return a force on one axis with its sign, and the magnitude of any other."""
    return force_n[0] if len(force_n) == 1 else math.hypot(*force_n)


class Rendering:
    """A device with its limits and, if it takes positions, its force loop; or none."""

    def __init__(self, device: Device | UserActuator | Fingertip | None, settings: MasterSettings, axes: int) -> None:
        self.fingertip: Fingertip | Actuator | None  # renders the force; None without a device
        if isinstance(device, UserActuator):
            self.fingertip = Actuator(device)
        elif device is None or isinstance(device, Fingertip):
            self.fingertip = device
        else:
            self.fingertip = Fingertip(device, settings.control)
        self.with_loop = self.fingertip if isinstance(self.fingertip, Fingertip) else None  # with a force loop
        self._axes = axes  # of the part that it renders
        self._actuator: Actuator | None = None  # one on several axes
        self._shown: tuple[int, ...] | None = None  # axes that are rendered; None: the norm of all
        self._one: int | None = None  # the only one of them
        self.adaptation: str | None = None  # how the force is adapted to the device, in words
        if self.fingertip is not None:
            has = self.fingertip.device.capabilities
            self._shown = device_axes(settings.device_takes, axes, has.axes)
            self._one = self._shown[0] if self._shown is not None and has.axes == 1 else None
            self._actuator = self.fingertip if isinstance(self.fingertip, Actuator) and has.axes > 1 else None
            self._padding = (0.0,) * (has.axes - len(self._shown or (0,)))
            self.adaptation = has.adaptation("the device", axes, self._shown, self.fingertip.largest_n)
        self._tracking = RunningError(settings.law)

    @property
    def what(self) -> str:
        """The device's name in messages."""
        return getattr(self.fingertip and self.fingertip.device, "what", "the device and its force loop")

    @property
    def largest_n(self) -> float:
        """Largest force [N] that the device renders; infinite without one."""
        return math.inf if self.fingertip is None else self.fingertip.largest_n

    @property
    def least_rate_hz(self) -> float:
        """Rate [Hz] below which the device's force loop must not run."""
        return self.with_loop.device.least_rate_hz if self.with_loop is not None else 0.0

    def adaptations(self, moved: Capabilities | None, settings: MasterSettings) -> list[str]:
        """Return in words how the force is adapted to this device, and to one in the hand, `moved`, if there is one."""
        lines = [] if self.adaptation is None else [self.adaptation]
        own = None if self.fingertip is None else self.fingertip.device.capabilities
        if moved is not None and moved.max_force_n != math.inf:
            lines.append(moved.adaptation("the device in the hand", moved.axes, range(moved.axes), moved.max_force_n))
        if settings.coupling == "direct" and any(each is not None and each.grounded for each in (own, moved)):
            lines.append(MAY_SWING)
        return lines

    def press(self, held_n: Vector, ahead_n: Vector, now_us: int, *, counts: bool) -> tuple[float, float, float]:
        """Render a force [N]; return force [N] requested and sensed, and displacement [m]. May raise anything."""
        fingertip = self.fingertip
        assert fingertip is not None, "there is a device"  # noqa: S101 - the caller's fault
        if self._actuator is not None:
            self._actuator.render(self._parts(held_n), now_us)
        else:
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
        """Return the part of a force [N] that a device with one axis renders."""
        return math.hypot(*force_n[: self._axes]) if self._one is None else force_n[self._one]

    def _parts(self, force_n: Vector) -> Vector:
        """Return the force [N] on the axes of a device with several."""
        if self._shown is None:
            return (math.hypot(*force_n[: self._axes]), *self._padding)
        return (*[force_n[axis] for axis in self._shown], *self._padding)
