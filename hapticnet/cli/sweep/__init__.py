"""``hapticnet sweep``: studies of many runs, and their tables and figures."""

from typing import Any, Final

import typer
from typer.core import TyperGroup

from hapticnet.cli.sweep import run, show

RUN: Final = "run"
HELP: Final = ("-h", "--help")


class WithoutVerb(TyperGroup):
    """Takes ``sweep STUDY.toml`` for ``sweep run STUDY.toml``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Add the verb where it is left out."""
        if args and args[0] not in self.commands and args[0] not in HELP:
            args = [RUN, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=WithoutVerb,
    no_args_is_help=True,
    help="Compute every combination of the settings in a study, with all cores or a cluster.\n\n"
    "'hapticnet sweep STUDY.toml' is short for 'hapticnet sweep run STUDY.toml'.",
)
app.command(RUN, short_help="Compute the missing runs of a study.")(run.run)
app.command("show", short_help="Print a table of the results, or draw a figure.")(show.show)
