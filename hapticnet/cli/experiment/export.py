"""``hapticnet experiment export``: the data as BIDS."""

from pathlib import Path
from typing import Annotated

import typer


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the study.")],
    bids: Annotated[Path, typer.Option(metavar="DIR", help="Write BIDS to this new folder.")],
    title: Annotated[str | None, typer.Option(help="Title of the data set; default: the folder's.")] = None,
    authors: Annotated[str, typer.Option(metavar="NAME[;NAME…]", help="Authors of the data set.")] = "",
) -> None:
    """Copy the data of a study in a standard form; no value changes, and the folder itself is left alone."""
    from hapticnet.cli.console import Console
    from hapticnet.study.export import export as write

    console = Console("experiment")
    title = folder.resolve().name if title is None else title
    written = write(folder, bids, name=title, people=authors)
    console.say(f"{len(written)} files: {bids}")
