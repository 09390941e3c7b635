"""``hapticnet device find`` and ``info``, without motion, and ``sim``: devices on serial ports."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from hapticnet import options

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticnet.device.wired import WiredDevice
    from hapticnet.runtime.serial_port import SerialSpec

Port: TypeAlias = Annotated[str, typer.Argument(metavar="DEVICE", help="serial:PATH or serial:auto.")]


def find() -> None:
    """List the serial ports of this host in the form that other commands take."""
    from hapticnet.cli.console import show
    from hapticnet.runtime.serial_port import find_ports

    ports = find_ports()
    likely = sum(port.likely is not None for port in ports)
    for port in ports:
        what = ", ".join(filter(None, (port.description, port.serial_number)))
        show(f"serial:{port.path}  {what or port.name}  ({port.likely or 'no sign of a Nano'})")
    if likely == 1:
        print("the first may be the device; serial:auto finds it")
    elif likely:
        print(f"the first {likely} may be the device; choose one")
    else:
        print("no port looks like an Arduino Nano; is it plugged in?")


def info(device: Port = "serial:auto", json: options.Json = False) -> None:
    """Show the identity of a device; if its protocol version differs, say how to flash the firmware."""
    from hapticnet.cli.console import deliver
    from hapticnet.device.messages import TICKS_PER_US
    from hapticnet.device.profile import GENERIC_CALIBRATION
    from hapticnet.device.wired import WiredDevice, firmware_version, reset_cause
    from hapticnet.errors import UnavailableError
    from hapticnet.runtime.serial_port import parse_serial

    spec = parse_serial(device)
    wired = WiredDevice(GENERIC_CALIBRATION)
    if not run_wired(wired, spec, lambda now_us: wired.exchange(0.0, now_us) is not None):
        raise typer.Exit(130)
    who = wired.identity
    if who is None:
        raise UnavailableError(f"{spec}: {wired.status}")
    account = {
        "device": str(spec),
        "firmware": firmware_version(who),
        "protocol": f"{who.protocol_major}.{who.protocol_minor}",
        "clock_mhz": who.clock_hz / 1e6,
        "boot_id": who.boot_id,
        "reset_cause": reset_cause(who),
        "stream_period_ms": wired.stream_period_ms,
        "adc_bits": who.adc_bits,
        "largest_step_us": who.largest_step / TICKS_PER_US,
        "servo": [
            {"shortest_pulse_us": shortest / TICKS_PER_US, "longest_pulse_us": longest / TICKS_PER_US}
            for shortest, longest in who.pulse_limits
        ],
    }
    deliver(account, as_json=json, file=None)


def sim(
    stiffness: Annotated[
        float, typer.Option(metavar="N/MM", help="Stiffness of the simulated finger at 1 N [N/mm].")
    ] = 1.0,
    seed: options.Seed = 0,
) -> None:
    """Run the compiled firmware with simulated servos, finger and sensor on a pseudo-terminal.

    Prints the terminal's path on stdout and runs in real time until Ctrl-C or SIGTERM. Any program can open it like a
    serial port: a master with --device serial:PATH. Build the simulator first: `make simulator`.
    """
    from contextlib import closing

    import numpy as np

    from hapticnet.cli.console import Console
    from hapticnet.device.simulated import Finger, PlantSettings
    from hapticnet.runtime.nano import Board, NanoPty, run_nano_pty
    from hapticnet.runtime.system import run

    settings = PlantSettings(finger=Finger(stiffness_n_m=1000.0 * stiffness))
    console = Console("sim", real_time=True)
    with closing(Board(settings, np.random.default_rng(seed))) as board, closing(NanoPty(board)) as nano:
        plant = board.plant

        def on_status() -> None:
            visitor = "in use" if nano.visited else "not in use"
            console.status(
                f"{visitor}; platform at {1e3 * plant.displacement_m:.2f} mm, {plant.contact_force_n:.2f} N; "
                f"{board.resets} resets, {nano.lost_us // 1000} ms skipped after stalls"
            )

        print(nano.path, flush=True)
        console.say(f"listening on {nano.path}, finger of {stiffness:g} N/mm")
        run(run_nano_pty(nano, on_status))
    console.finish()
    console.say(f"ended; {board.resets} resets, {nano.lost_us // 1000} ms skipped after stalls")


def run_wired(wired: "WiredDevice", spec: "SerialSpec", tick: "Callable[[int], bool]") -> bool:
    """Open a device and call `tick` until it is done; return False if a signal ended it. See `run_device`."""
    from hapticnet.runtime.serial_port import Wire, run_device
    from hapticnet.runtime.system import run

    return run(run_device(Wire(wired=wired, spec=spec), tick))


def profile_to_write(profile: Path | None, out: Path | None) -> Path | None:
    """Return the file to which a command writes the profile: `out`, else `profile`, else None.

    Raises SettingsError if the file exists and is not `profile`, so that earlier results would be lost; FileError if it
    cannot be written.
    """
    from hapticnet.cli.console import check_outputs
    from hapticnet.errors import SettingsError

    file = out or profile
    if file is not None and file != profile and file.exists():
        raise SettingsError(f"{file} exists; update it with --profile {file} or choose another file with --out FILE")
    check_outputs(file)
    return file
