"""The fingertip: limits, force loop and device, in the order in which a force passes them."""

import math
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from hapticnet.control.force import ForceController
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import ForceLimiter, LimitSettings
from hapticnet.device.base import Device, Reading


@dataclass(frozen=True, slots=True)
class DeviceLost:
    """The device gives no more readings; `reason` is its status."""

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
    """A device and the force loop that drives it.

    A device that returns after a loss is treated as a new one: it starts retracted and searches for the finger slowly.

    Attributes
    ----------
    device
        The device.
    controller
        The force loop.
    largest_n
        Largest force [N] that is requested, so that the overshoot of the loop stays within the device's limit.
    lead_us
        How far ahead [µs] the force is to be predicted, so that the servos reach it in time.
    target_n
        Force [N] requested of the device, after the limits.
    displacement_m
        Platform displacement last requested [m].
    reading
        The newest reading; None while the device is lost.
    """

    __slots__ = (
        "_events", "_fault", "_found", "_limiter", "_rise_n", "_times_lost", "controller", "device", "displacement_m",
        "largest_n", "lead_us", "reading", "target_n",
    )  # fmt: skip

    def __init__(self, device: Device, limits: LimitSettings, control: ForceControlSettings) -> None:
        self.device = device
        max_force_n = min(control.max_force_n, device.max_force_n)
        headroom_n = min(control.headroom_n, 0.5 * max_force_n)
        self.largest_n = max_force_n - headroom_n
        within_device = replace(
            control,
            travel_m=min(control.travel_m, device.travel_m),
            max_force_n=max_force_n,
            headroom_n=headroom_n,
            search_n=min(control.search_n, 0.5 * max_force_n),
            yield_n=min(control.yield_n, 0.5 * max_force_n),
        )
        self.controller = ForceController(within_device)
        self.target_n = 0.0
        self.displacement_m = 0.0
        self.reading: Reading | None = None
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
        """Move the device one step toward a force [N]; called every tick.

        Parameters
        ----------
        force_n
            Force [N] that is to be felt now.
        now_us
            Current time [µs].
        ahead_n
            Force [N] expected `lead_us` from now; None if nobody says. It rises no further above the target than the
            target can within that time.
        """
        reading = self.reading
        if reading is None:
            # Without a device the limiter falls to zero, from where the force rises when the device returns.
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
        """Return the account of this fingertip for JSON."""
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
