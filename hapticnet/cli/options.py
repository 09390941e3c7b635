"""Options shared by several commands."""

from pathlib import Path
from typing import Annotated, TypeAlias

import typer


def _codec_names(incomplete: str) -> list[str]:
    """Return the codec names that start with `incomplete`, for shell completion."""
    from hapticnet.codec.registry import all_codecs, register_installed_codecs

    register_installed_codecs()
    return [name for name in all_codecs() if name.startswith(incomplete)]


Codec: TypeAlias = Annotated[
    str,
    typer.Option(
        autocompletion=_codec_names,
        metavar="NAME[:KEY=VALUE,…]",
        help="Feedback codec; hapticnet codecs lists them. One of yours: FILE.py:CLASS or package.module:CLASS.",
    ),
]
Weber: TypeAlias = Annotated[float, typer.Option(help="Weber fraction k: JND = k·|force|. The paper's mean: 0.05.")]
Floor: TypeAlias = Annotated[float, typer.Option(help="Smallest JND [N]; applies where k·|force| is below it.")]
Multiplier: TypeAlias = Annotated[float, typer.Option(help="Deadband threshold in JNDs. The paper's: 1, 2, 4.")]
Seed: TypeAlias = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]
Position: TypeAlias = Annotated[
    str | None,
    typer.Option(metavar="NAME[,NAME…]", help="Position columns [m], for codecs and measures that need motion."),
]
PositionScale: TypeAlias = Annotated[
    float,
    typer.Option(
        metavar="M",
        help="Metres per unit of position; negative if positions increase in the direction of a positive force.",
    ),
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print the report as JSON on stdout.")]
Report: TypeAlias = Annotated[Path | None, typer.Option(metavar="FILE", help="Write the report to FILE as JSON too.")]
Force: TypeAlias = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
Quiet: TypeAlias = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors and the report.")]
ChannelOut: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="SPEC",
        help="Emulated network for outgoing datagrams: a preset (lan, wifi, 4g, transatlantic, satellite) or parts"
        " such as delay=20ms,jitter=normal:5ms,loss=2%.",
    ),
]
Realtime: TypeAlias = Annotated[bool, typer.Option(help="Use real-time scheduling (SCHED_FIFO) if permitted.")]
DeviceOption: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="DEVICE",
        help="Fingertip device: sim[:N/MM], simavr[:N/MM] (the compiled firmware, simulated), serial:auto,"
        " serial:PATH[@BAUD], or none. N/MM is the simulated finger's stiffness.",
    ),
]
DeviceArgument: TypeAlias = Annotated[
    str, typer.Argument(metavar="DEVICE", help="sim[:N/MM], simavr[:N/MM], serial:auto or serial:PATH[@BAUD].")
]
ProfileOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--profile", metavar="FILE", help="The device's calibration and finger, from hapticnet device."),
]
