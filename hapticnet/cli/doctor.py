"""``hapticnet doctor``: whether this machine can do it."""

from typing import TYPE_CHECKING, Annotated

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.runtime.serial_port import SerialSpec


def doctor(
    device: Annotated[
        str | None,
        typer.Option(
            metavar="DEVICE",
            help="Fingertip device that will be used: serial:auto, serial:PATH, simavr or sim. It is a problem if it is"
            " missing.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option(help="Leave out the 3 s of measuring.")] = False,
    json: options.Json = False,
) -> None:
    """Say whether this machine can run a slave and a master, and what to do where it cannot.

    Looks at timer, scheduling, clock, CPUs, packages, socket buffers, serial ports and the simulator. Measures round
    trip and ticks with a slave and a master on loopback for 3 s.

    Changes nothing on this machine, and opens no serial port. Each finding is ok, a warning (it works, but worse than
    it could), a problem (it will not work), or not present (needed for one use only).

    Exit code: 0 if there is no problem, 1 if there is one, 2 if the options are wrong.
    """
    from hapticnet.cli.console import Console, deliver
    from hapticnet.cli.doctor_page import print_page
    from hapticnet.experiment.provenance import provenance
    from hapticnet.runtime.doctor.checks import examine, probes
    from hapticnet.runtime.doctor.finding import Machine, Verdict, as_json
    from hapticnet.runtime.doctor.trial import examine_trial

    serial = _serial(device)
    simavr = device is not None and device.startswith("simavr")
    console = Console("doctor")
    looked = probes(Machine(), serial=serial, simavr=simavr)
    findings = list(examine(looked, lambda subject: console.status(f"looking at {subject}")))
    if not quick:
        console.status("measuring for 3 s")
        findings += examine_trial()
    console.finish()
    if json:
        deliver(as_json(findings), as_json=True, file=None)
    else:
        print_page(findings, provenance(), measured=not quick)
    if any(finding.verdict is Verdict.PROBLEM for finding in findings):
        raise typer.Exit(1)


def _serial(device: str | None) -> "SerialSpec | None":
    """Return the serial device in --device; None if it is not serial."""
    from hapticnet.runtime.devices import check_device
    from hapticnet.runtime.serial_port import parse_serial

    if device is None:
        return None
    check_device(device)
    return parse_serial(device) if device.startswith("serial") else None
