"""``hapticnet replay``: the hand of a recording to a slave again, or its force through a codec and a channel."""

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from hapticnet.cli import options
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hapticnet.recordings.recording import Motion

FASTEST_HZ: Final = 10_000.0
"""Highest rate at which recordings are replayed: what a slave grants if it was not told otherwise."""


def replay(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Recording of a session, or any file with positions and forces.")
    ],
    connect: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Play the hand to this slave, instead of the recorded force."),
    ] = None,
    key: options.KeyOption = None,
    peer_key: options.PeerKeyOption = None,
    insecure: options.Insecure = False,
    position_column: options.PositionColumn = None,
    force_column: options.ForceColumn = None,
    codec: options.Codec = "deadband",
    weber: options.Weber = PAPER_WEBER_FRACTION,
    floor: options.Floor = PAPER_FLOOR_N,
    multiplier: options.Multiplier = 1.0,
    channel_out: options.ChannelOut = "perfect",
    channel_in: options.ChannelIn = "perfect",
    device: options.DeviceOption = "none",
    profile: options.ProfileOption = None,
    rate: Annotated[
        float | None, typer.Option(help="Positions a second; by default as recorded.", show_default=False)
    ] = None,
    page: options.PageOption = None,
    seed: options.Seed = 0,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Record the replay in FILE: .mcap, .csv or .npz.")
    ] = None,
    real_time: options.RealTime = True,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Play a recording again.

    With --connect, its hand moves in the scene of that slave. Without, a slave on this machine answers with the
    recorded force, through any codec and channel: compare codecs on the device, feel what another person felt, or
    watch it on the page.
    """
    from hapticnet.cli.console import check_outputs
    from hapticnet.cli.master import master
    from hapticnet.errors import SettingsError
    from hapticnet.recordings.recording import load_motion

    check_outputs(record, report, inputs=[file])
    if connect is not None and force_column is not None:
        raise SettingsError("--force-column chooses the force, but with --connect the slave's scene makes the force")
    motion = load_motion(file, position=position_column)
    with _slave(file, force_column, codec, motion, connect, real_time=real_time) as address:
        master(
            connect=address,
            key=key,
            peer_key=peer_key,
            insecure=insecure,
            operator=f"trace:{file}" if position_column is None else f"trace:{file}:{position_column}",
            device=device,
            profile=profile,
            codec=codec,
            weber=weber,
            floor=floor,
            multiplier=multiplier,
            rate=rate or _rate_hz(motion.t_us.tolist()),
            name="replay",
            channel_out=channel_out,
            channel_in=channel_in,
            seed=seed,
            connect_timeout=10.0,
            page=page,
            record=record,
            real_time=real_time,
            json=json,
            report=report,
            quiet=quiet,
        )


def _rate_hz(t_us: list[int]) -> float:
    """Return the samples a second of a recording, as a rate that a slave grants."""
    from itertools import pairwise
    from statistics import median

    from hapticnet.protocol.ranges import RATE_HZ

    steps = [after - before for before, after in pairwise(t_us) if after > before]
    if not steps:
        return 1000.0
    # A tick that was late or left out makes a step longer, by whole periods in the end: a mean of steps would tell
    # another rate than the session had.
    usual_us = median(steps)
    periods = sum(round(step / usual_us) for step in steps)
    return min(max(round(1e6 * periods / sum(steps), 1), RATE_HZ.smallest), FASTEST_HZ)


@contextmanager
def _slave(
    file: Path, column: str | None, codec: str, motion: "Motion", connect: str | None, *, real_time: bool
) -> "Iterator[str]":
    """Yield the address of the slave: the one that was named, or one of our own that plays the recorded force."""
    from hapticnet.checks import axes_of
    from hapticnet.cli.console import Console
    from hapticnet.codec.registry import split_codec
    from hapticnet.errors import SettingsError
    from hapticnet.runtime.children import Child
    from hapticnet.scene.recorded import RecordedForce

    if connect is not None:
        yield connect
        return
    force = RecordedForce(file, columns=column)
    axes = motion.position.shape[1]
    if force.axes != axes:
        raise SettingsError(
            f"{file}: a force of {axes_of(force.axes)} for positions of {axes}; choose as many with"
            " --force-column and --position-column"
        )
    for note in force.notes:
        if note not in motion.notes:  # which the operator tells
            Console("replay").say(f"{file}: {note}")
    scene = f"recording:{file}" if column is None else f"recording:{file}:{column}"
    arguments = ["slave", "--listen", "127.0.0.1:0", "--scene", scene, "--add-codec", split_codec(codec)[0]]
    slave = Child(arguments if real_time else [*arguments, "--no-real-time"])
    try:
        yield slave.address()
    finally:
        slave.end()
