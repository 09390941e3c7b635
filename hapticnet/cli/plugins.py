"""Verbs of installed packages: entry points of the group ``hapticnet.verbs``, each a `typer.Typer`.

A package is imported when its verb is called, and not for ``hapticnet --help``. A verb of hapticnet has precedence.
`hapticnet.cli.verbs.equip` gives a package's application the features of hapticnet's own verbs.
"""

from copy import copy
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

import typer
from typer.core import TyperCommand, TyperGroup

from hapticnet.errors import UnavailableError

ENTRY_POINT_GROUP: Final = "hapticnet.verbs"
OUR_PACKAGES: Final = {"experiment": "extras/experiment", "gateway": "extras/gateway"}
"""Verbs that are in packages of their own in this repository, and their folders."""


class Verbs(TyperGroup):
    """The verbs of hapticnet, and those of installed packages."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all verbs."""
        own = super().list_commands(ctx)
        return [*own, *sorted(_installed().keys() - own)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a verb; None if there is none of this name."""
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        point = _installed().get(cmd_name)
        return VerbOfPackage(cmd_name, point) if point is not None or cmd_name in OUR_PACKAGES else None


class VerbOfPackage(TyperCommand):
    """Stands for a package's verb until it is called; `point` is None if the package is not installed."""

    def __init__(self, name: str, point: EntryPoint | None) -> None:
        summary = "" if point is None or point.dist is None else f"{point.dist.metadata['Summary']}."
        super().__init__(name, short_help=summary, help=summary)
        self._point = point

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Import the verb, and let it read its arguments; raise UnavailableError if it cannot be imported."""
        if self._point is None:
            raise UnavailableError(
                f"'hapticnet {self.name}' is in the package hapticnet-{self.name}, which is not installed; in a"
                f" checkout of hapticnet: pip install ./{OUR_PACKAGES[str(self.name)]}"
            )
        return _load(self._point).make_context(info_name, args, parent, **extra)


def _installed() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def _load(point: EntryPoint) -> Any:
    from hapticnet.user_code import raised

    holder = typer.Typer(add_completion=False, rich_markup_mode=None)
    try:
        app = point.load()
        if len(app.registered_commands) == 1 and not app.registered_groups:  # it is the verb, as typer itself has it
            verb = copy(app.registered_commands[0])
            verb.name = point.name
            holder.registered_commands.append(verb)
            holder.callback()(lambda: None)  # without it, typer makes no group of one command
        else:
            holder.add_typer(app, name=point.name)
        return typer.main.get_group(holder).commands[point.name]
    except BaseException as error:
        package = point.value if point.dist is None else point.dist.name
        raise UnavailableError(f"'hapticnet {point.name}', of the package {package}, raised {raised(error)}") from error
