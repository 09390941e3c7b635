"""``hapticnet compare``: which codec, at what rate, with what error, at what cost, how far from the best possible."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapticnet.cli import options
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hapticnet.codec.base import Codec
    from hapticnet.experiment.comparison import Row, Trial


def compare(
    traces: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[TRACE…]", help="Recordings, .csv or .npy; none: the paper's scene."),
    ] = None,
    column: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME…]", help="Force columns [N], by name or number from 0; one to three axes."),
    ] = None,
    position: options.Position = None,
    position_scale: options.PositionScale = 1.0,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Sampling rate; else from a column t_s, time_s or t_us.")
    ] = None,
    codecs: Annotated[
        str | None,
        typer.Option(metavar="CODEC[;CODEC…]", help="Codecs as NAME[:KEY=VALUE,…]; else all of them."),
    ] = None,
    thresholds: Annotated[str, typer.Option(metavar="M[,M…]", help="Deadband thresholds in JNDs.")] = "1,2,4",
    weber: options.Weber = PAPER_WEBER_FRACTION,
    floor: options.Floor = PAPER_FLOOR_N,
    loss: Annotated[
        str, typer.Option(metavar="P", help="Share of updates lost at random, such as 5%; repaired after 20 ms.")
    ] = "0",
    seed: options.Seed = 1,
    json: options.Json = False,
    plot: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw figures into DIR.")] = None,
) -> None:
    """Run every codec over recordings and compare packets, bytes, errors and cost with the best possible."""
    import json as json_module

    from hapticnet import __version__
    from hapticnet.channel.quantities import parse_share
    from hapticnet.cli.console import Console
    from hapticnet.errors import SettingsError
    from hapticnet.experiment.comparison import compare as compare_codecs
    from hapticnet.experiment.figures import pyplot
    from hapticnet.files import make_folder

    if not traces and any(option is not None for option in (column, position, rate)):
        raise SettingsError("--column, --position and --rate say how to read a TRACE, and none is named")
    chosen = _codecs(codecs, thresholds, weber, floor)
    lost = parse_share(loss)
    files = dict.fromkeys(traces or ())
    stems = [file.stem for file in files]
    trials = [
        _trial(file, file.stem if stems.count(file.stem) == 1 else str(file), column, position, position_scale, rate)
        for file in files
    ] or [_paper(seed)]
    if plot is not None:
        pyplot()  # which says at once where it is missing
        make_folder(plot)
    console = Console("compare", quiet=json)

    def on_row(row: "Row") -> None:
        console.status(f"{row.trial}: {row.label} at {row.multiplier:g} JND")

    rows = compare_codecs(trials, chosen, loss=lost, seed=seed, on_row=on_row)
    console.finish()
    if plot is not None:
        from hapticnet.experiment.comparison_figures import draw_comparison

        pictures = draw_comparison(rows, plot)
        for picture in pictures:
            console.say(f"picture: {picture}")
        if not pictures:
            console.say("no picture: raw alone has no error to draw anything over")
    if json:
        settings = {"version": __version__, "weber_fraction": weber, "floor_n": floor, "loss": lost, "seed": seed}
        recordings = [trial.account() for trial in trials]
        account = {"settings": settings, "recordings": recordings, "rows": [row.flat() for row in rows]}
        print(json_module.dumps(account, indent=2))
    else:
        from hapticnet.cli.compare_table import print_rows

        print_rows(rows, trials, lost)


def _codecs(names: str | None, thresholds: str, weber: float, floor: float) -> "list[Codec]":
    from hapticnet.codec.registry import CODECS, make_codec, parse_codec
    from hapticnet.errors import SettingsError
    from hapticnet.perception import WeberLaw

    try:
        multipliers = list(dict.fromkeys(float(part) for part in thresholds.split(",")))
    except ValueError:
        raise SettingsError(f"thresholds {thresholds!r} must be numbers of JNDs, such as 1,2,4") from None
    written: Iterable[str] = dict.fromkeys(CODECS if names is None else names.split(";"))
    return [
        make_codec(name, WeberLaw(weber_fraction=weber, floor_n=floor, multiplier=multiplier), parameters)
        for multiplier in multipliers
        for name, parameters in map(parse_codec, written)
        if name != "raw" or multiplier == multipliers[0]
    ]


def _trial(
    file: Path, name: str, column: str | None, position: str | None, position_scale: float, rate: float | None
) -> "Trial":
    import numpy as np

    from hapticnet.errors import FileError
    from hapticnet.experiment.comparison import Trial
    from hapticnet.experiment.recordings import load_positions, load_recording

    force = load_recording(file, columns=None if column is None else column.split(","), rate_hz=rate)
    if len(force.t_us) > 1 and not (np.diff(force.t_us) >= 0).all():
        raise FileError(f"{file}: time goes backwards; the samples must be in order")
    if len(force.t_us) < 2 or force.t_us[-1] == force.t_us[0]:
        raise FileError(f"{file}: {len(force.t_us)} samples over no time; two at different times are needed")
    where = load_positions(file, position, position_scale, like=force, rate_hz=rate)
    return Trial(name=name, t_us=force.t_us, stimuli=force.values, positions=where)


def _paper(seed: int) -> "Trial":
    from hapticnet.experiment.comparison import Trial
    from hapticnet.experiment.paper_force import paper_recording

    recorded = paper_recording(seed, rate_hz=1000.0, insertions=2)
    return Trial(
        name=f"paper's scene {seed}", t_us=recorded.t_us, stimuli=recorded.force_n, positions=recorded.position_m
    )
