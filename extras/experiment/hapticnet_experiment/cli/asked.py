"""The options of ``hapticnet experiment limits`` and ``order``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from hapticnet import options


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsOptions:
    """The options of ``hapticnet experiment limits``."""

    participant: Annotated[
        str,
        typer.Option(
            metavar="NUMBER", help="Number of the participant, such as 03; names are not stored. Simulated: also 01-08."
        ),
    ]
    session: Annotated[int, typer.Option(min=1, help="Number of the session.")] = 1
    plan: Annotated[
        str, typer.Option("--plan", metavar="PLAN", help="paper, reachable (1.8, 3.15 and 4.5 N), or a TOML file.")
    ] = "paper"
    seed: Annotated[int, typer.Option(min=0, help="Seed from which the whole session is drawn.")] = 0
    out_dir: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the study.")] = Path("study")
    device: options.Device = "sim"
    profile: options.Profile = None
    page: Annotated[
        str | None,
        typer.Option(
            "--page",
            metavar="[HOST:PORT]",
            help="Let the participant see and answer everything on a page in the browser, by default on 127.0.0.1:47880"
            " or a free port, and print its URL.",
        ),
    ] = None
    simulate: Annotated[
        str | None,
        typer.Option(metavar="OBSERVER", help="A simulated observer in the participant's place, such as literature."),
    ] = None
    jobs: options.Jobs = None
    resume: Annotated[bool, typer.Option(help="Continue an interrupted session of a person.")] = False
    json: options.Json = False
    quiet: options.Quiet = False


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderOptions(LimitsOptions):
    """The options of ``hapticnet experiment order``."""

    operator: Annotated[
        str | None,
        typer.Option(
            metavar="OPERATOR",
            show_default="page with --page, else udp:47810",
            help="A person's hand: page, udp:[HOST:]PORT, trace:FILE or a class of yours.",
        ),
    ] = None
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="A slave started with --scene hapticnet_experiment.scene:NamedTissues; otherwise one is started here.",
        ),
    ] = None
    key: options.Key = None
    peer_key: options.PeerKey = None
    insecure: options.Insecure = False
