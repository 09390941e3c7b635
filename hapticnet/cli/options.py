"""Options shared by several commands."""

from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

import typer

from hapticnet.files import MAX_BYTES, parse_bytes

MAX_SIZE: Final = MAX_BYTES
RECORD_LIMIT: Final = 2 * 2**30
AUTO: Final = "auto"
"""Address of the page where none is written."""

Missing: TypeAlias = Literal["refuse", "drop", "hold"]
RecordFormat: TypeAlias = Literal["csv", "mcap", "npz"]
ExportFormat: TypeAlias = Literal["csv", "mcap", "npz", "parquet"]
PlotFormat: TypeAlias = Literal["png", "pdf", "svg"]


Codec: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="NAME[:KEY=VALUE,…]",
        help="Feedback codec; hapticnet codecs lists them. One of yours: FILE.py:CLASS or package.module:CLASS.",
    ),
]
Weber: TypeAlias = Annotated[float, typer.Option(help="Weber fraction k: JND = k·|force|. The paper's mean: 0.05.")]
Floor: TypeAlias = Annotated[float, typer.Option(help="Smallest JND [N]; applies where k·|force| is below it.")]
Multiplier: TypeAlias = Annotated[float, typer.Option(help="Deadband threshold in JNDs. The paper's: 1, 2, 4.")]
Seed: TypeAlias = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]
ForceColumn: TypeAlias = Annotated[
    str | None,
    typer.Option(metavar="NAME[,NAME…]", help="Force columns [N], by name or number from 0; one to three axes."),
]
TimeColumn: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Column of the times, by name or number; default: one called t, time, timestamp …"
    ),
]
SamplingRate: TypeAlias = Annotated[
    float | None, typer.Option(metavar="HZ", help="Sampling rate of files without a column of times.")
]
PositionColumn: TypeAlias = Annotated[
    str | None,
    typer.Option(metavar="NAME[,NAME…]", help="Position columns [m]; default: those called position or pos."),
]
PositionScale: TypeAlias = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Metres per unit of position, instead of the unit in the column's name; negative if positions increase in"
        " the direction of a positive force.",
    ),
]
Start: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="X[,Y[,Z]]",
        help="Move all positions so that the first is at this place [m], to put a recorded hand into the scene.",
    ),
]
MissingValues: TypeAlias = Annotated[
    Missing,
    typer.Option(
        "--missing", help="Empty cells and NaN: refuse the file, drop such rows, or hold (repeat) the last value."
    ),
]
MaxSize: TypeAlias = Annotated[
    int,
    typer.Option(
        "--max-size",
        metavar="SIZE",
        parser=parse_bytes,
        show_default=False,
        help="Largest file that is read, such as 500MB or 8GiB; default: 2GiB.",
    ),
]
Jobs: TypeAlias = Annotated[
    int | None, typer.Option(min=1, help="Processes; default: one for each core. The results do not depend on it.")
]
RecordLimit: TypeAlias = Annotated[
    int,
    typer.Option(
        metavar="SIZE",
        parser=parse_bytes,
        show_default=False,
        help="Disk space that recordings may take, such as 500MB or 8GiB; default: 2GiB.",
    ),
]
Json: TypeAlias = Annotated[bool, typer.Option(help="Print the report as JSON on stdout.")]
Report: TypeAlias = Annotated[Path | None, typer.Option(metavar="FILE", help="Write the report to FILE as JSON too.")]
Overwrite: TypeAlias = Annotated[bool, typer.Option(help="Overwrite files that exist.")]
Quiet: TypeAlias = Annotated[bool, typer.Option("--quiet/--no-quiet", "-q", help="Print only errors and the report.")]
MetricsOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--metrics",
        metavar="HOST:PORT",
        help="Serve metrics for Prometheus at /metrics, and the state of this process at /health.",
    ),
]
ChannelOut: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="SPEC",
        help="Emulated network for outgoing datagrams: a preset (lan, wifi, 4g, transatlantic, satellite) or parts"
        " such as delay=20ms,jitter=normal:5ms,loss=2%.",
    ),
]
ChannelIn: TypeAlias = Annotated[
    str,
    typer.Option(metavar="SPEC", help="The same for arriving datagrams; together they emulate both directions."),
]
Announce: TypeAlias = Literal["declared", "measured", "nothing"]
DeviceTakes: TypeAlias = Literal["x", "y", "z", "norm"]
Positions: TypeAlias = Literal["raw", "line"]
SceneOption: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="SCENE",
        help="What masters touch: paper, paper:SEED, a preset, FILE.toml, recording:FILE[:COLUMN,…] (a force in its own"
        " time), or a class of yours with step(sample): FILE.py:CLASS or package.module:CLASS, then :KEY=VALUE,… for"
        " its arguments.",
    ),
]
OperatorOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="OPERATOR",
        help="Source of positions: scripted (insertions, the default), palpation[:axes=2] (on three or two axes), page"
        " (the live page; the default with --page), trace:FILE[:COLUMN,…] (a recording),"
        " udp:[HOST:]PORT[:axes=N] (another program), or a class of yours with sample(t_us): FILE.py:CLASS or"
        " package.module:CLASS.",
    ),
]
RealTime: TypeAlias = Annotated[bool, typer.Option(help="Use real-time scheduling (SCHED_FIFO) if permitted.")]
PageOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--page",
        metavar="[HOST:PORT]",
        help="Serve the live page, by default on 127.0.0.1:47880 or a free port, and print its URL; needs"
        " the extra web.",
    ),
]
DeviceOption: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="DEVICE",
        help="Fingertip device: sim[:N/MM], simavr[:N/MM] (the compiled firmware, simulated), serial:auto,"
        " serial:PATH[@BAUD], a class of yours with exchange or apply as FILE.py:CLASS or"
        " package.module:CLASS, or none. N/MM is the simulated finger's stiffness.",
    ),
]
DeviceArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="DEVICE", help="sim[:N/MM], simavr[:N/MM], serial:auto, serial:PATH[@BAUD] or FILE.py:CLASS."
    ),
]
KeyOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--key", envvar="HAPTICNET_KEY", metavar="FILE", help="This host's key file, made by 'hapticnet key new'."
    ),
]
PeerKeyOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--peer-key",
        envvar="HAPTICNET_PEER_KEY",
        metavar="BASE64",
        help="The slave's public key, printed by 'hapticnet key public' on its host.",
    ),
]
MastersOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--masters",
        envvar="HAPTICNET_MASTERS",
        metavar="FILE",
        help="The masters that are admitted, as [[master]] tables of a TOML file; read again on SIGHUP.",
    ),
]
Insecure: TypeAlias = Annotated[
    bool,
    typer.Option(help="Allow open sessions with other hosts: neither encrypted nor authenticated."),
]
KeyArgument: TypeAlias = Annotated[
    Path | None,
    typer.Argument(envvar="HAPTICNET_KEY", metavar="FILE", help="The key file; default: ~/.config/hapticnet/key.toml."),
]
MastersArgument: TypeAlias = Annotated[
    Path | None,
    typer.Argument(
        envvar="HAPTICNET_MASTERS",
        metavar="FILE",
        help="The slave's list of masters; default: masters.toml beside the key.",
    ),
]
ProfileOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--profile", metavar="FILE", help="The device's calibration and finger, from hapticnet device."),
]
