"""``hapticnet replay``: play a recorded hand to a slave, or a recorded force through a codec and a channel."""

from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from hapticnet import options
from hapticnet.options import Option
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hapticnet.recordings.loading import Motion

FASTEST_HZ: Final = 10_000.0
"""Highest rate at which recordings are replayed: what a slave grants by default."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """The options of ``hapticnet replay``."""

    file: Annotated[
        Path, Option("Recording of a session, or any file with positions and forces.", "FILE", argument=True)
    ]
    connect: Annotated[
        str | None, Option("Play the hand to this slave, instead of the recorded force.", "HOST:PORT")
    ] = None
    key: options.Key = None
    peer_key: options.PeerKey = None
    insecure: options.Insecure = False
    position_column: options.PositionColumn = None
    force_column: options.ForceColumn = None
    codec: options.Codec = "deadband"
    weber: options.Weber = PAPER_WEBER_FRACTION
    floor: options.Floor = PAPER_FLOOR_N
    multiplier: options.Multiplier = 1.0
    channel_out: options.ChannelOut = "perfect"
    channel_in: options.ChannelIn = "perfect"
    device: options.Device = "none"
    profile: options.Profile = None
    rate: Annotated[float | None, Option("Positions a second; by default as recorded.", "HZ", show_default=False)] = (
        None
    )
    page: options.Page = None
    seed: options.Seed = 0
    record: Annotated[Path | None, Option("Record the replay in FILE: .mcap or .csv.", "FILE")] = None
    real_time: options.RealTime = True
    json: options.Json = False
    report: options.Report = None
    quiet: options.Quiet = False


def replay(given: ReplayOptions) -> None:
    """Play a recording again.

    With --connect, its hand moves in the scene of that slave. Without, a slave on this machine answers with the
    recorded force, through any codec and channel: compare codecs on the device, feel what another person felt, or
    watch it on the page.
    """
    from hapticnet.cli.console import check_outputs
    from hapticnet.cli.given import MasterOptions
    from hapticnet.cli.master import join
    from hapticnet.errors import SettingsError
    from hapticnet.recordings.loading import load_motion

    file, column = given.file, given.position_column
    check_outputs(given.record, given.report, inputs=[file])
    if given.connect is not None and given.force_column is not None:
        raise SettingsError("--force-column chooses the force, but with --connect the slave's scene makes the force")
    motion = load_motion(file, position=column)
    shared = {each.name for each in fields(MasterOptions)} & {each.name for each in fields(ReplayOptions)}
    with _slave(given, motion) as address:
        join(
            MasterOptions(
                **{name: getattr(given, name) for name in shared}
                | {
                    "connect": address,
                    "operator": f"trace:{file}" if column is None else f"trace:{file}:{column}",
                    "rate": given.rate or _rate_hz(motion.t_us.tolist()),
                    "name": "replay",
                    "connect_timeout": 10.0,
                }
            )
        )


def _rate_hz(t_us: list[int]) -> float:
    """Return the samples a second of a recording, as a rate that a slave grants."""
    from itertools import pairwise
    from statistics import median

    from hapticnet.protocol.messages import RATE_HZ

    steps = [after - before for before, after in pairwise(t_us) if after > before]
    if not steps:
        return 1000.0
    # A late or missed tick makes a step longer, by whole periods in the end: a mean of steps would give
    # a lower rate than the session's.
    usual_us = median(steps)
    periods = sum(round(step / usual_us) for step in steps)
    return min(max(round(1e6 * periods / sum(steps), 1), RATE_HZ.smallest), FASTEST_HZ)


@contextmanager
def _slave(given: ReplayOptions, motion: "Motion") -> "Iterator[str]":
    """Yield the address of the slave: the named one, or our own slave that plays the recorded force."""
    from hapticnet.checks import axes_of
    from hapticnet.cli.console import Console
    from hapticnet.codec.registry import split_codec
    from hapticnet.errors import SettingsError
    from hapticnet.runtime.processes import Child
    from hapticnet.scene.sources import RecordedSource

    if given.connect is not None:
        yield given.connect
        return
    file, column = given.file, given.force_column
    force = RecordedSource(file, column)
    axes = motion.position.shape[1]
    if force.axes != axes:
        raise SettingsError(
            f"{file}: a force of {axes_of(force.axes)} for positions of {axes}; choose as many with"
            " --force-column and --position-column"
        )
    for note in force.notes:
        if note not in motion.notes:  # which the operator reports
            Console("replay").say(f"{file}: {note}")
    scene = f"recording:{file}" if column is None else f"recording:{file}:{column}"
    arguments = ["slave", "--listen", "127.0.0.1:0", "--scene", scene, "--add-codec", split_codec(given.codec)[0]]
    slave = Child(arguments if given.real_time else [*arguments, "--no-real-time"])
    try:
        yield slave.address()
    finally:
        slave.end()
