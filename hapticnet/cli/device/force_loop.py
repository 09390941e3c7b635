"""``hapticnet device tune`` and ``step``: press a finger to measure it and the force loop."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from hapticnet import options
from hapticnet.cli.device.wired import profile_to_write

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticnet.device.base import Device
    from hapticnet.device.profile import Profile
    from hapticnet.node.procedures import StepTest, Tuning

TICK_US = 1000
Procedure = TypeVar("Procedure", "Tuning", "StepTest")


def tune(
    device: options.DeviceArgument = "sim",
    profile: options.Profile = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Profile to write. Default: the --profile, or none.")
    ] = None,
    max_force: Annotated[float, typer.Option(metavar="NEWTONS", min=0.0, help="Strongest force used [N].")] = 2.0,
    seed: options.Seed = 0,
    json: options.Json = False,
) -> None:
    """Find the finger, press it with a few increasing forces, and report its position and stiffness.

    The margin is the factor by which the finger may become stiffer before the force loop oscillates. Tuning takes about
    ten seconds on a real device. From a profile, the result becomes the force loop's prior.
    """
    import datetime
    from dataclasses import asdict

    from hapticnet.cli.console import deliver, write_text
    from hapticnet.control.force_settings import ForceControlSettings
    from hapticnet.control.margins import Actuator, loop_margins
    from hapticnet.device.profile import MeasuredFinger, dump_profile
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.node.procedures import Tuning
    from hapticnet.runtime import devices

    known = devices.load(profile)
    file = profile_to_write(profile, out)

    def prepare(made: "Device") -> Tuning:
        # The finger may be anywhere within the travel.
        fingertip = Fingertip(made, ForceControlSettings(reach_m=made.capabilities.travel_m))
        return Tuning(fingertip, max_force_n=max_force)

    made, tuning = _drive(device, known, seed, prepare)
    tuned = tuning.result()
    today = datetime.date.today().isoformat()
    finger = MeasuredFinger(stiffness_n_m=tuned.stiffness_n_m, contact_m=max(0.0, tuned.contact_m), date=today)
    tuned_profile = known.changed(finger=finger)
    if file is not None:
        write_text(file, dump_profile(tuned_profile))
    margins = loop_margins(
        devices.control_settings(tuned_profile), Actuator(), force_n=tuned.forces_n[-1], stiffness=1.0
    )
    points = [
        {"force_n": force_n, "displacement_m": displacement_m}
        for force_n, displacement_m in zip(tuned.forces_n, tuned.displacements_m, strict=True)
    ]
    account: dict[str, Any] = {
        "device": made.description,
        "stiffness_n_m": tuned.stiffness_n_m,
        "contact_m": tuned.contact_m,
        "residual_m": tuned.residual_m,
        "point": points,
        "margins": asdict(margins),
        "profile": str(file) if file else None,
    }
    deliver(account, as_json=json, file=None)


def step(
    device: options.DeviceArgument = "sim",
    from_n: Annotated[float, typer.Option("--from", metavar="NEWTONS", help="Force before the step [N].")] = 0.4,
    to_n: Annotated[float, typer.Option("--to", metavar="NEWTONS", help="Force after the step [N].")] = 2.0,
    profile: options.Profile = None,
    seed: options.Seed = 0,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the response to FILE (.png, .pdf or .svg).")
    ] = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Press a finger with one force, step to another, and report rise, overshoot, settling and ripple.

    Simulated devices run in virtual time; simavr runs the compiled firmware. The figures describe the sensed force,
    averaged over a control period like the loop's input, and the true force if it is known.
    """
    from dataclasses import asdict

    import numpy as np

    from hapticnet.cli.console import Console, check_new, check_outputs, deliver
    from hapticnet.errors import UnavailableError
    from hapticnet.experiment.step_response import averaged, plot_step, step_figures
    from hapticnet.experiment.style import check_format, pyplot
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.node.procedures import StepTest
    from hapticnet.runtime import devices

    known = devices.load(profile)
    control = devices.control_settings(known)
    if plot is not None:
        check_format(plot.suffix[1:])
        pyplot()
    check_outputs(plot, inputs=[profile])
    check_new(plot, overwrite=overwrite)

    def prepare(made: "Device") -> StepTest:
        return StepTest(Fingertip(made, control), from_n=from_n, to_n=to_n)

    made, test = _drive(device, known, seed, prepare)
    columns = test.recording.table()
    t_s, at_s = columns["t_us"] * 1e-6, (test.step_us or 0) * 1e-6
    forces = {"sensed": averaged(columns["sensed_n"], control.period_us // 1000), "true": columns["true_n"]}
    account: dict[str, Any] = {"device": made.description, "from_n": from_n, "to_n": to_n}
    for name, force_n in forces.items():
        if np.isfinite(force_n).all():
            account[name] = asdict(step_figures(t_s, force_n, at_s=at_s, from_n=from_n, to_n=to_n))
    account["fingertip"] = test.fingertip.report()
    if plot is not None:
        plot_step(
            plot,
            t_s - at_s,
            columns["target_n"],
            forces["sensed"],
            contact_force_n=forces["true"] if "true" in account else None,
            title=made.description,
        )
        Console("step").say(f"figure: {plot}")
    deliver(account, as_json=json, file=None)
    if account["sensed"]["rise_s"] is None:
        raise UnavailableError(
            f"the force did not reach 90 % of the step: it is {forces['sensed'][-1]:.2f} N at the end, not {to_n:g} N"
        )


def _drive(
    text: str, known: "Profile", seed: int, prepare: "Callable[[Device], Procedure]"
) -> "tuple[Device, Procedure]":
    """Open the device written as `text`, prepare and run its procedure, close it, and return both.

    A simulated device runs in virtual time, any other in real time.
    """
    import os

    from hapticnet.runtime import devices

    if text.startswith("simavr"):
        # Simulator and process take turns, and waking another core is slower.
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with devices.virtual_device(text, known, seed) as device:
        if device is not None:
            procedure, now_us = prepare(device), 0
            while not procedure.tick(now_us):
                now_us += TICK_US
            return device, procedure
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
        procedure = prepare(device)
        if not run(run_device(wire, procedure.tick)):
            raise typer.Exit(130)
        return device, procedure
