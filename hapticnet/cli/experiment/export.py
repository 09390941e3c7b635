"""``hapticnet experiment export``: the data as BIDS or Psych-DS."""

from pathlib import Path
from typing import Annotated

import typer


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the study.")],
    bids: Annotated[Path | None, typer.Option(metavar="DIR", help="Write BIDS to this new folder.")] = None,
    psych_ds: Annotated[Path | None, typer.Option(metavar="DIR", help="Write Psych-DS to this new folder.")] = None,
    title: Annotated[str | None, typer.Option(help="Title of the data set; default: the folder's.")] = None,
    authors: Annotated[str, typer.Option(metavar="NAME[;NAME…]", help="Authors of the data set.")] = "",
) -> None:
    """Copy the data of a study in a standard form; no value changes, and the folder itself is left alone."""
    from hapticnet.cli.console import Console
    from hapticnet.errors import SettingsError
    from hapticnet.study.export import export as write

    if bids is None and psych_ds is None:
        raise SettingsError("choose a form: --bids DIR or --psych-ds DIR, or both")
    console = Console("experiment")
    title = folder.resolve().name if title is None else title
    for target, form in ((bids, "bids"), (psych_ds, "psych-ds")):
        if target is not None:
            written = write(folder, target, form, name=title, people=authors)  # type: ignore[arg-type]
            console.say(f"{len(written)} files: {target}")
