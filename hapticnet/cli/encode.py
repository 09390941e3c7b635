"""``hapticnet encode``: what a codec would cost and do on a recorded force."""

from pathlib import Path
from typing import Annotated

import typer

from hapticnet.cli import options
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION


def encode(
    file: Annotated[Path, typer.Argument(help="Recording: .csv or .npy.")],
    column: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME…]", help="Force columns [N], by name or number from 0; one to three axes."),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Sampling rate; else from a column t_s, time_s or t_us.")
    ] = None,
    position: options.Position = None,
    position_scale: options.PositionScale = 1.0,
    codec: options.Codec = "deadband",
    weber: options.Weber = PAPER_WEBER_FRACTION,
    floor: options.Floor = PAPER_FLOOR_N,
    multiplier: options.Multiplier = 1.0,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the decoded stream to FILE as CSV.")] = None,
    json: options.Json = False,
    report: options.Report = None,
) -> None:
    """Run a codec over a recorded force and report what it would have cost and done."""
    import time
    from dataclasses import asdict

    from hapticnet.cli.console import Console, check_outputs, deliver
    from hapticnet.codec.recording import encode_array
    from hapticnet.codec.registry import make_codec, parse_codec
    from hapticnet.errors import FileError, SampleError
    from hapticnet.experiment.recordings import load_positions, load_recording
    from hapticnet.node.offline import cost_report
    from hapticnet.perception import WeberLaw
    from hapticnet.tables import write_csv

    check_outputs(out, report, inputs=[file])
    name, parameters = parse_codec(codec)
    chosen = make_codec(name, WeberLaw(weber_fraction=weber, floor_n=floor, multiplier=multiplier), parameters)
    recording = load_recording(file, columns=None if column is None else column.split(","), rate_hz=rate)
    positions = load_positions(file, position, position_scale, like=recording, rate_hz=rate)
    if positions is None and chosen.needs_position:
        Console("encode").say(f"{chosen.name} depends on the tool's motion; without --position it does as at rest")
    started = time.perf_counter()
    try:
        encoding = encode_array(chosen, recording.t_us, recording.values, positions)
    except SampleError as error:
        raise FileError(f"{file}: {error}") from error
    seconds = time.perf_counter() - started
    cost = cost_report(chosen, recording.t_us, recording.values, encoding)
    if out is not None:
        decoded = {name: encoding.decoded[:, axis] for axis, name in enumerate(recording.names)}
        write_csv(out, {"t_us": recording.t_us, **decoded})
    account = {**asdict(cost), "samples_per_second": cost.samples / seconds}
    deliver(account, as_json=json, file=report)
