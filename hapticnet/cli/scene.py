"""``hapticnet scene``: look at a scene without a network."""

from pathlib import Path
from typing import Annotated

import typer

from hapticnet import options

app = typer.Typer(no_args_is_help=True, help="Look at a scene without a network.")

Spec = Annotated[
    str, typer.Argument(metavar="SCENE", help="paper, paper:SEED, a preset, a TOML file, or FILE.py:CLASS.")
]


@app.command(short_help="Print the tissues or bodies of a scene.")
def show(scene: Spec = "paper:0", json: options.Json = False, report: options.Report = None) -> None:
    """Print the tissues of a scene, from front to back, or its bodies; for your own class, its name and axes."""
    from dataclasses import asdict

    from hapticnet.cli.console import check_outputs, deliver
    from hapticnet.scene.settings import BodySceneSettings
    from hapticnet.scene.sources import UserSource, find_scene, find_source, scene_names

    source = find_source(scene)
    check_outputs(report, inputs=[source.file])
    if isinstance(source, UserSource):
        made = source.make()
        deliver({"name": made.name, "axes": made.axes}, as_json=json, file=report)
        return
    settings = find_scene(scene)
    others = {"other_scenes": ", ".join(["paper:SEED", *scene_names()])}
    if isinstance(settings, BodySceneSettings):
        bodies = [{key: value for key, value in asdict(body).items() if value != 0.0} for body in settings.bodies]
        account = {"name": settings.name, "axes": settings.axes, "body": bodies}
        deliver({**account, **others}, as_json=json, file=report)
        return
    tissues = []
    for tissue in settings.tissues:
        declared = {key: value for key, value in asdict(tissue).items() if value != 0.0}
        if not tissue.shaft_friction_n:
            del declared["shaft_presliding_m"]  # describes the onset of friction, and there is none
        tissues.append({**declared, "breaches_at_m": tissue.rest_position_m + tissue.breach_depth_m})
    deliver({"name": settings.name, "tissue": tissues, **others}, as_json=json, file=report)


@app.command("run", short_help="Move the tool along recorded positions.")
def run_scene(
    scene: Spec,
    trace: Annotated[Path, typer.Option(metavar="FILE", help="Positions: .csv, .tsv, .npy, .npz, .mat, .parquet.")],
    position_column: options.PositionColumn = None,
    position_scale: options.PositionScale = None,
    start: options.Start = None,
    time_column: options.TimeColumn = None,
    sampling_rate: options.SamplingRate = None,
    missing: options.MissingValues = "refuse",
    max_size: options.MaxSize = options.MAX_SIZE,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write there instead of to stdout.")] = None,
) -> None:
    """Move the tool along recorded positions; print force and state of every sample as CSV.

    With FILE.py:CLASS or package.module:CLASS this tries a scene of yours without a network.
    """
    import sys

    import numpy as np

    from hapticnet.cli.console import Console, check_outputs
    from hapticnet.errors import SettingsError
    from hapticnet.experiment.trials import placed
    from hapticnet.node.recording import axis_columns
    from hapticnet.recordings.loading import load_motion
    from hapticnet.recordings.text import write_csv
    from hapticnet.samples import PositionSample
    from hapticnet.scene.base import breaches_of
    from hapticnet.scene.bodies import BodyScene
    from hapticnet.scene.scene import Scene
    from hapticnet.scene.sources import find_source

    source = find_source(scene)
    check_outputs(out, inputs=[trace, source.file])
    motion = load_motion(
        trace,
        position=position_column,
        position_scale=position_scale,
        time=time_column,
        rate_hz=sampling_rate,
        missing=missing,
        max_bytes=max_size,
    )
    path_m = placed(motion.position, start)
    world = source.make()
    axes = motion.position.shape[1]
    if axes != world.axes:
        raise SettingsError(f"position columns chosen: {axes}; {world.name} needs {world.axes}")
    for note in motion.notes:
        Console("scene").say(f"{trace}: {note}")
    rows = []
    for t_us, position_m in zip(motion.t_us.tolist(), map(tuple, path_m.tolist()), strict=True):
        force = world.step(PositionSample(t_us, position_m))
        state: tuple[float, ...] = ()
        if isinstance(world, Scene):
            state = (*world.contacts(), *world.surfaces_m())
        elif isinstance(world, BodyScene):
            state = (*world.contacts(), *world.depths_m())
        rows.append((t_us, *position_m, *force.force_n, breaches_of(world), *state))
    layers = [tissue.name for tissue in world.tissues] if isinstance(world, Scene) else []
    layers += [body.name for body in world.bodies] if isinstance(world, BodyScene) else []
    where = "surface_m" if isinstance(world, Scene) else "depth_m"
    names = ["t_us", *axis_columns("position", "m", axes), *axis_columns("force", "n", axes), "breaches"]
    names += [f"{layer}_contact" for layer in layers] + [f"{layer}_{where}" for layer in layers]
    table = np.array(rows, dtype=np.float64).reshape(-1, len(names))
    whole = {"t_us", "breaches", *(f"{layer}_contact" for layer in layers)}
    columns = {
        name: table[:, index].astype(np.int64) if name in whole else table[:, index] for index, name in enumerate(names)
    }
    write_csv(out or sys.stdout, columns)
