"""``hapticnet device tune``: measure the finger, so that the force loop knows it from the start."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.device.base import Device


def tune(
    device: options.DeviceArgument = "sim",
    profile: options.Profile = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Profile to write. Default: that of --profile, or none.")
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
    from dataclasses import asdict, replace

    from hapticnet.cli.console import deliver, write_text
    from hapticnet.cli.device.driving import drive
    from hapticnet.cli.profiles import profile_to_write
    from hapticnet.control.force_settings import ForceControlSettings
    from hapticnet.control.limits import LimitSettings
    from hapticnet.control.margins import Actuator, loop_margins
    from hapticnet.device.profile import MeasuredFinger, dump_profile
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.node.procedures import Tuning
    from hapticnet.runtime import devices

    known = devices.load(profile)
    file = profile_to_write(profile, out)
    tunings: list[Tuning] = []

    def prepare(made: "Device") -> Callable[[int], bool]:
        # The finger may be anywhere within the travel.
        fingertip = Fingertip(made, LimitSettings(), ForceControlSettings(reach_m=made.travel_m))
        tunings.append(Tuning(fingertip, max_force_n=max_force))
        return tunings[0].tick

    made = drive(device, known, seed, prepare)
    tuned = tunings[0].result()
    finger = MeasuredFinger(
        stiffness_n_m=tuned.stiffness_n_m, contact_m=max(0.0, tuned.contact_m), date=datetime.date.today().isoformat()
    )
    tuned_profile = replace(known, finger=finger)
    if file is not None:
        write_text(file, dump_profile(tuned_profile))
    control = devices.control_settings(tuned_profile)
    margins = loop_margins(control, Actuator(), force_n=tuned.forces_n[-1], stiffness=1.0)
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
