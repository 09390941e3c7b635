"""``hapticnet encode``: cost and error of a codec on a recorded force."""

from pathlib import Path
from typing import Annotated, Final

import typer

from hapticnet import options
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

LONGEST_REPEATED_S: Final = 5.0
"""Longest run that is repeated to measure its speed."""


def encode(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording: .csv, .tsv, .npy, .npz, .mat or .parquet.")],
    force_column: options.ForceColumn = None,
    time_column: options.TimeColumn = None,
    sampling_rate: options.SamplingRate = None,
    position_column: options.PositionColumn = None,
    position_scale: options.PositionScale = None,
    missing: options.MissingValues = "refuse",
    max_size: options.MaxSize = options.MAX_SIZE,
    codec: options.Codec = "deadband",
    weber: options.Weber = PAPER_WEBER_FRACTION,
    floor: options.Floor = PAPER_FLOOR_N,
    multiplier: options.Multiplier = 1.0,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the decoded stream to FILE as CSV.")] = None,
    json: options.Json = False,
    report: options.Report = None,
) -> None:
    """Run a codec over a recorded force and report cost and error."""
    import math
    import time
    from dataclasses import asdict

    from hapticnet.api.encoding import Encoded
    from hapticnet.cli.console import Console, check_outputs, deliver
    from hapticnet.codec.recording import encode_array
    from hapticnet.codec.registry import make_codec, parse_codec
    from hapticnet.errors import FileError, SampleError
    from hapticnet.perception import WeberLaw
    from hapticnet.recordings.loading import load_recording
    from hapticnet.recordings.text import write_csv

    check_outputs(csv, report, inputs=[file])
    name, parameters = parse_codec(codec)
    chosen = make_codec(name, WeberLaw(weber_fraction=weber, floor_n=floor, multiplier=multiplier), parameters)
    recording = load_recording(
        file,
        columns=force_column,
        position=position_column,
        position_scale=position_scale,
        time=time_column,
        rate_hz=sampling_rate,
        missing=missing,
        max_bytes=max_size,
    )
    console = Console("encode")
    for note in recording.notes:
        console.say(f"{file}: {note}")
    if recording.position is None and chosen.needs_position:
        console.say(
            f"{chosen.name} depends on the tool's motion, and no column is called position: it behaves as if at rest;"
            " name the positions with --position-column"
        )
    seconds = math.inf
    try:
        # The first run may load compiled code; a second one shows the codec's own speed.
        for _ in range(2):
            started = time.perf_counter()
            encoding = encode_array(chosen, recording.t_us, recording.force, recording.position)
            seconds = min(seconds, time.perf_counter() - started)
            if seconds > LONGEST_REPEATED_S:
                break
    except SampleError as error:
        raise FileError(f"{file}: {error}") from error
    encoded = Encoded(
        codec=chosen,
        t_us=recording.t_us,
        force=recording.force,
        decoded=encoding.decoded,
        sent=encoding.sent,
        payload_bytes=encoding.payload_bytes,
        position=recording.position,
    )
    if csv is not None:
        decoded = {name: encoding.decoded[:, axis] for axis, name in enumerate(recording.names)}
        write_csv(csv, {"t_us": recording.t_us, **decoded})
    account = {**asdict(encoded.report()), "samples_per_second": len(recording.t_us) / seconds}
    deliver(account, as_json=json, file=report)
