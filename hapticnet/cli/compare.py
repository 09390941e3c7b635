"""``hapticnet compare``: rate, error and cost of codecs, and their distance from the best possible."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticnet import options
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

if TYPE_CHECKING:
    from hapticnet.experiment.comparison import Row
    from hapticnet.experiment.trials import Trial
    from hapticnet.recordings.loading import Motion, Recording


def compare(
    traces: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="TRACE", help="Recordings: .csv, .tsv, .npy, .npz, .mat or .mcap; default: the paper's scene."
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE", help="Scene that is touched along the positions of TRACE, or by a scripted hand."
        ),
    ] = None,
    start: options.Start = None,
    force_column: options.ForceColumn = None,
    position_column: options.PositionColumn = None,
    position_scale: options.PositionScale = None,
    time_column: options.TimeColumn = None,
    sampling_rate: options.SamplingRate = None,
    missing: options.MissingValues = "refuse",
    max_size: options.MaxSize = options.MAX_SIZE,
    codecs: Annotated[
        str | None, typer.Option(metavar="CODEC[;CODEC…]", help="Codecs as for master --codec; default: all.")
    ] = None,
    multipliers: Annotated[str, typer.Option(metavar="M[,M…]", help="Deadband thresholds in JNDs.")] = "1,2,4",
    weber: options.Weber = PAPER_WEBER_FRACTION,
    floor: options.Floor = PAPER_FLOOR_N,
    loss: Annotated[
        str, typer.Option(metavar="PERCENT", help="Share of updates lost at random, such as 5%; repaired after 20 ms.")
    ] = "0",
    delay: Annotated[
        str, typer.Option(metavar="TIME", help="Delay each way at which the felt force is judged, such as 25ms.")
    ] = "25ms",
    seed: options.Seed = 1,
    jobs: options.Jobs = None,
    json: options.Json = False,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write every figure to FILE as CSV.")] = None,
    plot_dir: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw figures into DIR.")] = None,
    plot_format: Annotated[options.PlotFormat, typer.Option(help="Format of the figures.")] = "png",
    overwrite: options.Overwrite = False,
) -> None:
    """Run every codec over recordings and compare packets, bytes, errors and cost with the best possible."""
    import json as json_module
    import os

    from hapticnet.channel.settings import parse_share, parse_time_us
    from hapticnet.cli.console import Console, check_new, check_outputs, write_text
    from hapticnet.codec.registry import all_codecs, register_installed_codecs
    from hapticnet.errors import SettingsError
    from hapticnet.experiment.comparison import compare as compare_codecs
    from hapticnet.experiment.comparison_table import csv_of, print_rows
    from hapticnet.experiment.grid import grid_codecs
    from hapticnet.experiment.provenance import provenance, provenance_lines
    from hapticnet.experiment.trials import paper_trial

    if not traces and any(option is not None for option in (force_column, position_column, time_column, sampling_rate)):
        raise SettingsError(
            "--force-column, --position-column, --time-column and --sampling-rate say how to read a TRACE, and none is"
            " named"
        )
    if scene is not None and force_column is not None:
        raise SettingsError("--force-column names a recorded force; with --scene the force is the scene's")
    if start is not None and (scene is None or not traces):
        raise SettingsError("--start moves the positions of a TRACE in a --scene; name both")
    lost = parse_share(loss)
    law = {"multiplier": _numbers(multipliers), "weber_fraction": [weber], "floor_n": [floor]}
    delay_us = parse_time_us(delay)
    if codecs is None:
        for problem in register_installed_codecs():
            Console("compare").say(problem)
    chosen = grid_codecs(list(all_codecs()) if codecs is None else codecs.split(";"), law)
    files = dict.fromkeys(traces or ())
    say = Console("compare").say
    reading = {
        "position": position_column,
        "position_scale": position_scale,
        "time": time_column,
        "rate_hz": sampling_rate,
        "missing": missing,
    }
    if scene is not None:
        trials = _scene_trials(scene, list(files), say, start=start, seed=seed, **reading, max_bytes=max_size)
    else:
        trials = _recorded_trials(list(files), say, columns=force_column, **reading, max_bytes=max_size)
        trials = trials or [paper_trial(seed, insertions=2)]
    check_outputs(csv, inputs=files)
    check_new(csv, overwrite=overwrite)
    figures = None
    if plot_dir is not None:
        from hapticnet.experiment.comparison_figures import Figures

        figures = Figures(trials, chosen, folder=plot_dir, form=plot_format, seed=seed)
        check_outputs(*figures.files)
        check_new(*figures.files, overwrite=overwrite)
    console = Console("compare", quiet=json)
    runs = len(trials) * len(chosen)
    done = 0

    def on_row(row: "Row") -> None:
        nonlocal done
        done += 1
        console.progress(f"{done} of {runs}: {row.trial}, {row.label} at {row.multiplier:g} JND")

    console.status(f"0 of {runs}")
    processes = min(jobs or len(os.sched_getaffinity(0)), runs)
    rows = compare_codecs(trials, chosen, loss=lost, delay_us=delay_us, seed=seed, jobs=processes, on_row=on_row)
    console.finish()
    if figures is not None:
        for picture in figures.draw(rows):
            console.say(f"picture: {picture}")
    if csv is not None:
        write_text(csv, csv_of(rows, provenance_lines()))
        console.say(f"table: {csv}")
    if json:
        settings = {"seed": seed, **law, "loss": lost, "delay_us": delay_us}
        print(json_module.dumps({"provenance": provenance(), "settings": settings, **_account(trials, rows)}, indent=2))
    else:
        print_rows(rows, trials)


def _account(trials: "list[Trial]", rows: "list[Row]") -> dict[str, Any]:
    from dataclasses import asdict

    from hapticnet.experiment.summary import blocks, means

    return {
        "recordings": [trial.account() for trial in trials],
        "rows": [row.flat() for row in rows],
        "means": [asdict(block) for block in means(blocks(rows))],
    }


def _numbers(multipliers: str) -> list[float]:
    from hapticnet.errors import SettingsError

    try:
        return list(dict.fromkeys(float(part) for part in multipliers.split(",")))
    except ValueError:
        raise SettingsError(f"--multipliers {multipliers!r} must be numbers of JNDs, such as 1,2,4") from None


def _recorded_trials(files: Sequence[Path], say: Callable[[str], None], **reading: Any) -> "list[Trial]":
    """Return the forces and positions of files; `reading` says how to read them, as for `load_recording`."""
    from hapticnet.experiment.trials import Trial
    from hapticnet.recordings.loading import load_recording

    return [
        Trial(name=name, t_us=found.t_us, stimuli=found.force, positions=found.position)
        for name, found in _read(files, partial(load_recording, **reading), say)
    ]


def _scene_trials(
    scene: str, files: Sequence[Path], say: Callable[[str], None], *, start: str | None, seed: int, **reading: Any
) -> "list[Trial]":
    """Return the forces of a scene along the positions of files, or of a scripted hand if there are none.

    The first position of each file is moved to `start`, coordinates [m] as text; None: not moved. `reading` says how
    to read the files, as for `load_motion`.
    """
    import numpy as np

    from hapticnet.experiment.trials import placed, scene_trial
    from hapticnet.operator.scripted import scripted_hand
    from hapticnet.operator.trace import TraceOperator
    from hapticnet.recordings.loading import load_motion
    from hapticnet.scene.sources import find_source

    source = find_source(scene)
    if not files:
        touched = source.make()
        hand = scripted_hand(touched.axes, 2, np.random.default_rng(seed))
        return [scene_trial(touched, hand, name=f"{source.name}, scripted hand {seed}")]
    trials = []
    for name, motion in _read(files, partial(load_motion, **reading), say):
        trace = TraceOperator(motion.t_us, placed(motion.position, start))
        trials.append(scene_trial(source.make(), trace, name=f"{source.name}, {name}"))
    return trials


def _read(
    files: Sequence[Path], read: "Callable[[Path], Motion | Recording]", say: Callable[[str], None]
) -> "list[tuple[str, Any]]":
    """Return name and content of each file; files whose names are alike get their whole paths."""
    from hapticnet.experiment.trials import check_lasts

    stems = [file.stem for file in files]
    found = []
    for file in files:
        content = read(file)
        for note in content.notes:
            say(f"{file}: {note}")
        check_lasts(file, content.t_us)
        found.append((file.stem if stems.count(file.stem) == 1 else str(file), content))
    return found
