"""``hapticnet device step``: measure the step response of the force loop, as in the paper's Fig. 2."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.device.base import Device


def step(
    device: options.DeviceArgument = "sim",
    from_n: Annotated[float, typer.Option("--from", metavar="NEWTONS", help="Force before the step [N].")] = 0.4,
    to_n: Annotated[float, typer.Option("--to", metavar="NEWTONS", help="Force after the step [N].")] = 2.0,
    profile: options.Profile = None,
    seed: options.Seed = 0,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the response to FILE (.png, .pdf or .svg).")
    ] = None,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write every tick to FILE.")] = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Press a finger with one force, step to another, and report rise, overshoot, settling and ripple.

    Simulated devices run in virtual time; simavr runs the compiled firmware. The figures are those of the sensed force,
    averaged over a control period like the loop's input, and of the true force if it is known.
    """
    from dataclasses import asdict

    import numpy as np

    from hapticnet.cli.console import Console, check_new, check_outputs, deliver
    from hapticnet.cli.device.driving import drive
    from hapticnet.control.limits import LimitSettings
    from hapticnet.errors import UnavailableError
    from hapticnet.experiment.step_response import averaged, plot_step, step_figures
    from hapticnet.experiment.style import check_format, pyplot
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.node.procedures import StepTest
    from hapticnet.recordings.tables import write_csv
    from hapticnet.runtime import devices

    known = devices.load(profile)
    control = devices.control_settings(known)
    if plot is not None:
        check_format(plot.suffix[1:])
        pyplot()
    check_outputs(plot, csv, inputs=[profile])
    check_new(plot, overwrite=overwrite)
    tests: list[StepTest] = []

    def prepare(made: "Device") -> Callable[[int], bool]:
        tests.append(StepTest(Fingertip(made, LimitSettings(), control), from_n=from_n, to_n=to_n))
        return tests[0].tick

    made = drive(device, known, seed, prepare)
    columns = tests[0].recording.table()
    if csv is not None:
        write_csv(csv, columns)
    t_s, at_s = columns["t_us"] * 1e-6, (tests[0].step_us or 0) * 1e-6
    forces = {"sensed": averaged(columns["sensed_n"], control.period_us // 1000), "true": columns["true_n"]}
    account: dict[str, Any] = {"device": made.description, "from_n": from_n, "to_n": to_n}
    for name, force_n in forces.items():
        if np.isfinite(force_n).all():
            account[name] = asdict(step_figures(t_s, force_n, at_s=at_s, from_n=from_n, to_n=to_n))
    account["fingertip"] = tests[0].fingertip.report()
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
