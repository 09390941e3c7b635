"""Run a procedure on a device: in virtual time on a simulated one, in real time on any other."""

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticnet.device.base import Device
    from hapticnet.device.profile import Profile

TICK_US = 1000


def drive(text: str, known: "Profile", seed: int, prepare: "Callable[[Device], Callable[[int], bool]]") -> "Device":
    """Open the device written as `text`, call `prepare` for a procedure's tick, and tick until it is done.

    Returns the device, closed, whose report is still available.
    """
    from hapticnet.runtime import devices

    if text.startswith("simavr"):
        _share_a_core()
    with devices.virtual_device(text, known, seed) as device:
        if device is not None:
            tick, now_us = prepare(device), 0
            while not tick(now_us):
                now_us += TICK_US
            return device
    from hapticnet.cli.console import Console
    from hapticnet.device.user import UserActuator
    from hapticnet.errors import SettingsError
    from hapticnet.runtime.serial_port import run_device
    from hapticnet.runtime.system import run

    console = Console("device", real_time=True)
    console.say(f"opening {text}, which will press the finger; withdraw the finger or press Ctrl-C to end")
    if known.is_generic and text.startswith("serial"):
        console.warn(devices.NOT_CALIBRATED)
    with devices.real_time_device(text, known, seed, console.warn) as (device, wire):
        assert device is not None  # noqa: S101 - for the type checker: virtual_device refuses "none"
        if isinstance(device, UserActuator):
            raise SettingsError(f"device {text} renders forces by itself; there is no force loop to try")
        if not run(run_device(wire, prepare(device))):
            raise typer.Exit(130)
        return device


def _share_a_core() -> None:
    """Pin the process, and the simulator it starts, to one core: they take turns, and waking another core is slower."""
    import os

    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
