"""Devices named by a text, such as ``sim:0.3`` or ``serial:auto``: parse it and make the device."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

import numpy as np

from hapticnet.checks import check_parameter, meant
from hapticnet.control.force_settings import ForceControlSettings, for_known_finger
from hapticnet.device.base import Device
from hapticnet.device.profile import Profile, load_profile
from hapticnet.device.servos import Servo
from hapticnet.device.simulated import Finger, PlantSettings, SimulatedDevice
from hapticnet.device.user import UserActuator, UserDevice, as_user_device
from hapticnet.device.wired import WiredDevice
from hapticnet.errors import SettingsError, UserCodeError
from hapticnet.hardware import SOFTEST_N_M, STIFFEST_N_M
from hapticnet.runtime.nano import SimulatedNano, simavr_build
from hapticnet.runtime.processes import Child
from hapticnet.runtime.serial_port import SerialSpec, Wire, parse_serial
from hapticnet.runtime.system import now_us
from hapticnet.user_code import UserClass, close_user_object, find_installed_class, find_user_class

NOT_CALIBRATED: Final = "the force sensor is not calibrated (see hapticnet device calibrate); forces may be far off"
DEVICES: Final = "sim[:N/MM], simavr[:N/MM], serial:auto, serial:PATH, FILE.py:CLASS, package.module:CLASS"
"""Device specifications; N/MM is the simulated finger's stiffness. Installed packages offer others by their names."""

BUILT_IN: Final = ("sim", "simavr", "serial", "none")
ENTRY_POINT_GROUP: Final = "hapticnet.devices"


@contextmanager
def real_time_device(
    text: str, profile: Profile, seed: int, say: Callable[[str], None]
) -> Iterator[tuple[Device | UserActuator | None, Wire | None]]:
    """Yield the device written as `text` for real time, None for ``none``, and its wire if it has one.

    `say` is called if a user's device cannot be closed. SettingsError, or UnavailableError without a simulator.
    """
    if text == "none":
        yield None, None
        return
    if (found := _user_class(text)) is not None:
        with _user_device(found, say) as device:
            yield device, None
        return
    kind, settings = _parse(text)
    if settings is None:
        wired = _wired(profile)
        yield wired, Wire(wired=wired, spec=parse_serial(text))
    elif kind == "sim":
        yield SimulatedDevice(settings, _rng(seed)), None
    else:
        simavr_build()  # fail here, with a clear message, instead of in a child process
        stiffness = settings.finger.stiffness_n_m / 1000.0
        child = Child(["device", "sim", "--seed", str(seed), "--stiffness", str(stiffness)])
        try:
            wired = _wired(profile)
            yield wired, Wire(wired=wired, spec=SerialSpec(child.address()))
        finally:
            child.end()


@contextmanager
def virtual_device(text: str, profile: Profile, seed: int) -> Iterator[Device | None]:
    """Yield the device written as `text` for virtual time, or None if it is a real one. Raises the same."""
    kind, settings = ("own", None) if _user_class(text) else _parse(text)
    if settings is None:
        yield None
    elif kind == "sim":
        yield SimulatedDevice(settings, _rng(seed))
    else:
        with closing(SimulatedNano(settings, _rng(seed), wired=_wired(profile, settings.servo))) as nano:
            yield nano


def check_device(text: str) -> None:
    """Raise SettingsError if there is no such device."""
    if not _user_class(text):
        _parse(text)


def load(path: Path | None) -> Profile:
    """Return the profile in a file, or an empty one."""
    return load_profile(path) if path is not None else Profile()


def control_settings(profile: Profile) -> ForceControlSettings:
    """Return the force loop's settings for the finger in a profile."""
    if profile.finger is None:
        return ForceControlSettings()
    return for_known_finger(stiffness_n_m=profile.finger.stiffness_n_m, contact_m=profile.finger.contact_m)


def _user_class(text: str) -> UserClass | None:
    """Return the user's class that `text` names; None for a device of hapticnet."""
    if text.partition(":")[0] in BUILT_IN:
        return None
    return find_installed_class(text, "device", ENTRY_POINT_GROUP) or find_user_class(text, "device")


@contextmanager
def _user_device(found: UserClass, say: Callable[[str], None]) -> Iterator[UserDevice | UserActuator]:
    """Yield a user's device; at the end set its force to zero and call its ``close()``, if any."""
    device = as_user_device(found.make(), found.label)
    try:
        yield device
    finally:
        with suppress(UserCodeError):
            device.rest(now_us())
        if (fault := close_user_object(device.made, found.label)) is not None:
            say(fault)


def _parse(text: str) -> tuple[str, PlantSettings | None]:
    kind, separator, stiffness = text.partition(":")
    if kind == "serial":
        return kind, None
    if kind not in ("sim", "simavr"):
        known = [*BUILT_IN, *(point.name for point in entry_points(group=ENTRY_POINT_GROUP))]
        raise SettingsError(
            f"unknown device {text!r}{meant(kind, known)}; choose from {DEVICES}"
            + "".join(f", {name}" for name in known[len(BUILT_IN) :])
        )
    if not separator:
        return kind, PlantSettings()
    try:
        n_per_mm = float(stiffness)
    except ValueError:
        raise SettingsError(
            f"stiffness {stiffness!r} of device {text!r} must be a number of N/mm, such as sim:0.3"
        ) from None
    check_parameter(f"stiffness of device {text!r}", n_per_mm, SOFTEST_N_M / 1000.0, STIFFEST_N_M / 1000.0, "N/mm")
    return kind, PlantSettings(finger=Finger(stiffness_n_m=1000.0 * n_per_mm))


def _wired(profile: Profile, servo: Servo | None = None) -> WiredDevice:
    servo = servo or Servo()
    if profile.servo_lag_s is not None:
        servo = replace(servo, lag_s=profile.servo_lag_s)
    return WiredDevice(profile.table, servo=servo)


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 4])
