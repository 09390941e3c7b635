"""``hapticnet device info``: show the identity of a device."""

from typing import Annotated

import typer

from hapticnet import options


def info(
    device: Annotated[str, typer.Argument(metavar="DEVICE", help="serial:PORT[@BAUD] or serial:auto.")] = "serial:auto",
    json: options.Json = False,
) -> None:
    """Show the identity of a device; if its protocol version differs, say how to flash the firmware."""
    from hapticnet.cli.console import deliver
    from hapticnet.device.messages import TICKS_PER_US
    from hapticnet.device.profile import GENERIC_CALIBRATION
    from hapticnet.device.wired import WiredDevice, firmware_version, reset_cause
    from hapticnet.errors import UnavailableError
    from hapticnet.runtime.serial_port import Wire, parse_serial, run_device
    from hapticnet.runtime.system import run

    spec = parse_serial(device)
    wired = WiredDevice(GENERIC_CALIBRATION)
    if not run(run_device(Wire(wired=wired, spec=spec), lambda now_us: wired.exchange(0.0, now_us) is not None)):
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
