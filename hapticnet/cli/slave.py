"""``hapticnet slave``: host the scene and answer masters."""

from pathlib import Path
from typing import Annotated

import typer

from hapticnet.cli import options


def slave(
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where to listen; port 0 takes a free one.")] = (
        "127.0.0.1:47800"
    ),
    scene: options.SceneOption = "paper:0",
    duration: Annotated[float | None, typer.Option(min=0.0, help="Stop after this many seconds.")] = None,
    drain: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="When stopped, take no new masters and let the present ones finish for up to this long.",
        ),
    ] = 0.0,
    key: options.KeyOption = None,
    masters: options.MastersOption = None,
    insecure: options.Insecure = False,
    keep: Annotated[
        float, typer.Option(metavar="SECONDS", help="Keep the scene of a silent master this long for its return.")
    ] = 30.0,
    fastest_rate: Annotated[float, typer.Option(help="Highest sample rate granted to a master [Hz].")] = 10_000.0,
    most_sessions: Annotated[int, typer.Option(min=1, help="Sessions served at once.")] = 64,
    most_sessions_per_key: Annotated[
        int, typer.Option(min=1, help="Sessions of one key at once (without keys, of one host), unless the list says.")
    ] = 16,
    announce: Annotated[
        options.Announce,
        typer.Option(
            help="What to tell masters that ask for the contact ahead: what the scene declares, or what was"
            " measured of it."
        ),
    ] = "declared",
    add_codec: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE.py:CLASS",
            help="Codec of yours that masters may ask for, or package.module:CLASS; repeat for more. Codecs of"
            " installed packages are always served.",
        ),
    ] = None,
    channel_out: options.ChannelOut = "perfect",
    seed: options.Seed = 0,
    record_dir: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Record each session in DIR/NAME-SESSION and the format's suffix."),
    ] = None,
    record_format: Annotated[options.RecordFormat, typer.Option(help="Format of the recordings.")] = "csv",
    record_limit: options.RecordLimit = options.RECORD_LIMIT,
    metrics: options.MetricsOption = None,
    real_time: options.RealTime = True,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Host the virtual tissues: each master touches its own scene.

    On loopback, anyone is served unless --key or --masters is given. Elsewhere, only the masters of the list are
    served: --key and --masters, by default key.toml and masters.toml in ~/.config/hapticnet.

    Ends on Ctrl-C, SIGTERM or after --duration, and then prints its report. A second signal ends --drain.
    """
    from hapticnet.cli.slave_setup import SlaveOptions, serve

    serve(
        SlaveOptions(
            listen=listen,
            scene=scene,
            duration=duration,
            drain=drain,
            key=key,
            masters=masters,
            insecure=insecure,
            keep=keep,
            fastest_rate=fastest_rate,
            most_sessions=most_sessions,
            most_sessions_per_key=most_sessions_per_key,
            announce=announce,
            add_codec=tuple(add_codec or ()),
            channel_out=channel_out,
            seed=seed,
            record_dir=record_dir,
            record_format=record_format,
            record_limit=record_limit,
            metrics=metrics,
            real_time=real_time,
            json=json,
            report=report,
            quiet=quiet,
        )
    )
