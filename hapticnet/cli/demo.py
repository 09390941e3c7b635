"""``hapticnet demo``: the paper's experiment on this machine, in about a minute."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.experiment.conditions import Condition

RESULTS = Path("results/demo")

SHOWN = "1 JND"
"""The condition of the figure of a run."""


def demo(
    seed: options.Seed = 1,
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE", help="Scene that is touched, such as phantom; default: the paper's, of the seed."
        ),
    ] = None,
    insertions: Annotated[int, typer.Option(min=1, help="Insertions, or palpations, per condition.")] = 2,
    device: options.Device = "sim",
    codec: options.Codec = "deadband",
    announced: Annotated[
        bool,
        typer.Option(help="Let the slave announce the contact ahead, so that the device is in time."),
    ] = False,
    rate: Annotated[float, typer.Option(help="Positions a second.")] = 1000.0,
    page: options.Page = None,
    out_dir: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for figures, JSON and recordings; default: results/demo, or the next free -N."
        ),
    ] = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Play the paper's four conditions with a slave and a master process on loopback, and compare them.

    The picture bytes_per_penetration.png is the paper's Fig. 4.

    With --page, move the needle yourself in a browser instead, until Ctrl-C; nothing is written then.
    """
    import json as json_module
    import signal
    import sys

    from hapticnet.cli.console import Console, check_new, check_outputs, write_text
    from hapticnet.cli.demo_page import play_on_page
    from hapticnet.cli.demo_table import print_table
    from hapticnet.codec.registry import make_codec, parse_codec
    from hapticnet.errors import SettingsError, UnavailableError
    from hapticnet.experiment.conditions import CONDITIONS
    from hapticnet.experiment.demo import disturbances, play_conditions, results
    from hapticnet.experiment.figures import draw_bytes_per_penetration, draw_run
    from hapticnet.experiment.provenance import provenance
    from hapticnet.files import fresh_path
    from hapticnet.perception import WeberLaw
    from hapticnet.runtime.devices import check_device
    from hapticnet.runtime.nano import simavr_build
    from hapticnet.scene.settings import BodySceneSettings
    from hapticnet.scene.sources import find_scene

    name, parameters = parse_codec(codec)
    make_codec(name, WeberLaw(), parameters)  # refuse it before anything is played
    check_device(device)
    if device.startswith("simavr"):
        simavr_build()
    if page is not None:
        if scene is not None:
            raise SettingsError(
                "--page plays the paper's scene; for another: hapticnet slave --scene, and master --page"
            )
        if json or out_dir is not None:
            raise SettingsError("--page is played live and writes no results; omit --out-dir and --json")
        signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
        play_on_page(page, Console("demo", quiet=quiet), seed=seed, device=device, codec=codec, rate_hz=rate)
        return
    out = fresh_path(RESULTS) if out_dir is None else out_dir
    report, bytes_figure, run_figure = (out / name for name in ("demo.json", "bytes_per_penetration.png", "run.png"))
    check_outputs(report, bytes_figure, run_figure)
    check_new(report, bytes_figure, run_figure, overwrite=overwrite)
    # Python does not clean up on SIGTERM by default; exiting this way ends the two processes first.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    console = Console("demo", quiet=quiet)
    scene = scene or f"paper:{seed}"
    found = find_scene(scene)
    bodies = isinstance(found, BodySceneSettings)
    what = "palpation" if bodies else "insertion"
    console.say(f"{found.name}, {insertions} {what}{'s' if insertions > 1 else ''}, felt four ways; about a minute")
    told: set[str] = set()

    def on_progress(condition: "Condition", seconds: float) -> None:
        if condition.name not in told:
            told.add(condition.name)
            console.say(f"condition {len(told)} of {len(CONDITIONS)}: {condition.name}")
        console.status(f"{condition.name}: {seconds:.0f} s")

    played = play_conditions(
        out,
        scene=scene,
        axes=found.axes if isinstance(found, BodySceneSettings) else 1,
        codec=codec,
        seed=seed,
        insertions=insertions,
        device=device,
        rate_hz=rate,
        announced=announced,
        on_progress=on_progress,
    )
    console.finish()
    disturbed = disturbances(played)
    if disturbed is not None:
        console.warn(f"delays and tracking may be worse than the system's own: {disturbed}")
    rows = results(played, () if isinstance(found, BodySceneSettings) else found.tissues)
    settings = {
        "scene": scene,
        "seed": seed,
        "insertions": insertions,
        "rate_hz": rate,
        "device": device,
        "codec": codec,
        "announced": announced,
    }
    text = json_module.dumps({"provenance": provenance(), **settings, "conditions": rows}, indent=2)
    write_text(report, text + "\n")
    print(text) if json else print_table(rows)
    try:
        draw_bytes_per_penetration(rows, bytes_figure)
        shown = next(each for each in played if each.condition.name == SHOWN)
        draw_run(shown.slave_samples, shown.master_samples, run_figure, codec=f"{codec}, {SHOWN}")
    except UnavailableError as error:
        console.say(str(error))
    else:
        console.say(f"figures: {bytes_figure}, {run_figure}")
    console.say(f"all numbers: {report}")
