"""``hapticnet config``: each option of a verb, its value, and where the value came from."""

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from hapticnet import options
from hapticnet.files import user_path

DEFAULT: Final = "default"  # the source of a value that nobody set
SETTINGS: Final = {"allow_interspersed_args": False, "ignore_unknown_options": True}
"""Leaves what follows the verb to the verb."""


def config(
    ctx: typer.Context,
    verb: Annotated[
        list[str] | None, typer.Argument(metavar="VERB OPTIONS", help="A verb and options for it, as one would run it.")
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option("--config", envvar="HAPTICNET_CONFIG", metavar="FILE", help="The TOML file with options."),
    ] = None,
    json: options.Json = False,
) -> None:
    """Print each option of a verb with its value and where the value came from; the verb is not run.

    An option on the command line takes precedence over the environment (HAPTICNET_MASTER_CODEC for the --codec of
    master), which takes precedence over the file given by --config; otherwise the default applies.

    Without a verb, print what file and environment set, for all verbs. Variables that begin with HAPTICNET_ and set
    nothing are told as warnings.
    """
    import os

    from hapticnet.cli.console import Console
    from hapticnet.cli.settings import from_environment, from_file, leaves, option_key, own_variables, unknown_to_all

    root: Any = ctx.find_root()
    for line in unknown_to_all(root.command, os.environ):
        Console("config").warn(line)
    known = dict(leaves(root.command))
    file = None if file is None else user_path(file)
    in_file = {} if file is None else from_file(file, root.command)
    if verb:
        rows = _resolve(root, verb, file)
    else:
        rows = [
            {"verb": " ".join(words), "option": option_key(option), "value": found.value, "source": found.source}
            for words, command in known.items()
            for option in command.params
            for name, found in (
                in_file.get(words, {})
                | from_environment(words, command, os.environ)
                | own_variables(command, os.environ)
            ).items()
            if name == option.name
        ]
    if json:
        import json as json_module

        print(json_module.dumps(rows, indent=2, default=str))
    else:
        _print(rows)


def _resolve(root: Any, arguments: list[str], file: Path | None) -> list[dict[str, Any]]:
    """Return the options of the verb that the arguments start with, as a run with these arguments would see them."""
    from hapticnet.cli.settings import leaves, option_key, settable, verb_of
    from hapticnet.cli.verbs import found_of
    from hapticnet.errors import SettingsError
    from hapticnet.files import bytes_in_words

    verbs = dict(leaves(root.command))
    words = next((tuple(arguments[:count]) for count in (1, 2) if tuple(arguments[:count]) in verbs), None)
    if words is None:
        names = ", ".join(" ".join(each) for each in verbs)
        raise SettingsError(f"unknown verb {' '.join(arguments[:2])!r}; choose from {names}")
    context, command = root, verbs[words]
    for word in words[:-1]:
        context = type(root)(context.command.commands[word], parent=context, info_name=word)
    given = ["--config", str(file)] if file is not None else []
    context = command.make_context(words[-1], [*given, *arguments[len(words) :]], parent=context)
    found = found_of(context)
    rows = []
    for option in settable(command).values():
        source = context.get_parameter_source(option.name)
        described = {
            "COMMANDLINE": "command line",
            "ENVIRONMENT": str(option.envvar),
            "DEFAULT_MAP": found[option.name].source if option.name in found else DEFAULT,
        }.get(source.name if source is not None else "", DEFAULT)
        value = context.params.get(option.name)
        if option.metavar == "SIZE" and isinstance(value, int):
            value = bytes_in_words(value)
        rows.append(
            {"verb": " ".join(verb_of(context)), "option": option_key(option), "value": value, "source": described}
        )
    return rows


def _print(rows: list[dict[str, Any]]) -> None:
    from hapticnet.cli.console import print_table

    if not rows:
        print("neither a file nor the environment sets an option; hapticnet config VERB lists the defaults")
        return
    verbs = len({row["verb"] for row in rows})
    print_table((f"{row['verb']} " * (verbs > 1) + f"--{row['option']}", row["value"], row["source"]) for row in rows)
