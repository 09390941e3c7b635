"""Values of options from a configuration file and from the environment, and ``hapticnet config``, which shows them."""

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import typer

from hapticnet import options
from hapticnet.checks import meant
from hapticnet.errors import SettingsError
from hapticnet.files import bytes_in_words, user_path

PREFIX: Final = "HAPTICNET_"  # start of the names of environment variables
CONFIG_VARIABLE: Final = "HAPTICNET_CONFIG"  # environment variable that names the configuration file
OTHER_VARIABLES: Final = {CONFIG_VARIABLE, "HAPTICNET_TRACEBACK", "HAPTICNET_FIRMWARE"}
"""Environment variables that set no option: `cli.SHOW_TRACEBACK` and `runtime.nano.BUILD_VARIABLE` are the others."""

FOUND: Final = "hapticnet.found"  # key of a context's values from file and environment
DEFAULT: Final = "default"  # the source of a default
SETTINGS: Final = {"allow_interspersed_args": False, "ignore_unknown_options": True}  # leave the rest to the verb
UNSETTABLE: Final = {"help", "config"}  # options for the command line only
FLAGS: Final = {  # values of a flag in the environment
    **dict.fromkeys(("1", "true", "yes", "on"), True),
    **dict.fromkeys(("0", "false", "no", "off"), False),
}

Verb: TypeAlias = tuple[str, ...]  # the words of a verb, such as ("device", "step")


@dataclass(frozen=True, slots=True)
class Found:
    """The value of an option that was not given on the command line."""

    value: str | bool | list[str]  # the value as on the command line; True or False for a flag
    source: str  # where it was found, for people: a file and its table, or an environment variable


def leaves(command: Any, verb: Verb = ()) -> Iterator[tuple[Verb, Any]]:
    """Yield each verb with its command, depth first."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield verb, command
    else:
        for name, each in inner.items():
            yield from leaves(each, (*verb, name))


def option_key(option: Any) -> str:
    """Return an option's name in a file: its long name without dashes."""
    return str(max(option.opts, key=len)).lstrip("-")


def settable(command: Any) -> dict[str, Any]:
    """Return the options of a command that files and the environment may set, by their names in files."""
    options = {option_key(each): each for each in command.params if each.param_type_name == "option"}
    return {key: option for key, option in options.items() if key not in UNSETTABLE}


def variable(verb: Verb, key: str) -> str:
    """Return the environment variable that sets an option."""
    return PREFIX + "_".join((*verb, key)).replace("-", "_").upper()


def from_environment(verb: Verb, command: Any, environment: Mapping[str, str]) -> dict[str, Found]:
    """Return the values from the environment by the parameters' names; empty variables set nothing.

    Raise SettingsError if the value of a flag is neither true nor false.
    """
    found = {}
    for key, option in settable(command).items():
        name = variable(verb, key)
        text = environment.get(name, "")
        if not text:
            continue
        value: str | bool | list[str] = text
        if option.is_flag:
            if text.lower() not in FLAGS:
                raise SettingsError(f"{name} is {text!r}; it must be one of {', '.join(FLAGS)}")
            value = FLAGS[text.lower()]
        elif option.multiple:
            value = text.split()
        found[option.name] = Found(value, name)
    return found


def own_variables(command: Any, environment: Mapping[str, str]) -> dict[str, Found]:
    """Return the values of shared variables, such as HAPTICNET_KEY, by the parameters' names."""
    shared = {each.name: str(each.envvar) for each in settable(command).values() if each.envvar}
    return {name: Found(environment[each], each) for name, each in shared.items() if environment.get(each)}


def unknown_variables(verb: Verb, command: Any, environment: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for each environment variable that looks like an option of a verb but is not."""
    start = variable(verb, "")
    known = [variable(verb, key) for key in settable(command)]
    for name in environment:
        if name.startswith(start) and name not in known:
            guess = _guess(name, known)
            yield f"the environment variable {name} is ignored: {' '.join(verb)} has no such option{guess}"


def unknown_to_all(root: Any, environment: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for each environment variable with hapticnet's prefix that no verb reads."""
    known = set(OTHER_VARIABLES)
    for verb, command in leaves(root):
        known |= {variable(verb, key) for key in settable(command)}
        known |= {str(each.envvar) for each in command.params if each.envvar}
    for name in sorted(environment):
        if name.startswith(PREFIX) and name not in known:
            yield f"the environment variable {name} is ignored: no verb has such an option{meant(name, sorted(known))}"


def from_file(path: Path, root: Any) -> dict[Verb, dict[str, Found]]:
    """Return the values in a configuration file, for each verb, by the parameters' names.

    Raise FileError if the file cannot be read or is not TOML; SettingsError if a table or key is unknown, or a value
    has the wrong type.
    """
    from hapticnet.documents import parse_tables, read_document

    known = dict(leaves(root))
    found: dict[Verb, dict[str, Found]] = {verb: {} for verb in known}

    def visit(table: Mapping[str, Any], verb: Verb) -> None:
        options = settable(known[verb]) if verb in known else {}
        verbs = {each[len(verb)] for each in known if each[: len(verb)] == verb and len(each) > len(verb)}
        where = f"{path}: {_in_brackets(verb)}" if verb else f"{path}:"
        for key, value in table.items():
            if key in verbs and isinstance(value, dict):
                visit(value, (*verb, key))
            elif key in options:
                option = options[key]
                found[verb][option.name] = Found(
                    _checked(value, option, f"{where} {key}"), f"{path} {_in_brackets(verb)}"
                )
            elif key in verbs:
                raise SettingsError(f"{where} {key} is a command; write its options below {_in_brackets((*verb, key))}")
            else:
                kind = "table" if isinstance(value, dict) else "key"
                shown = _in_brackets((*verb, key)) if kind == "table" else repr(key)
                raise SettingsError(f"{where} unknown {kind} {shown}{_guess(key, [*options, *verbs])}")

    visit(parse_tables(read_document(path), str(path)), ())
    return found


def _checked(value: Any, option: Any, where: str) -> str | bool | list[str]:
    """Return a value of a file as the command line would give it."""
    if value == "":
        raise SettingsError(f"{where} is empty; {wanted(option)}")
    if option.is_flag:
        if isinstance(value, bool):
            return value
        raise SettingsError(f"{where} is {value!r}; it must be true or false")
    if option.multiple:
        if isinstance(value, list) and all(_is_plain(each) for each in value):
            return [str(each) for each in value]
        raise SettingsError(f"{where} is {value!r}; it must be a list, such as ['one', 'two']")
    if _is_plain(value):
        return str(value)
    raise SettingsError(f"{where} is {value!r}; it must be text in quotes or a number")


def wanted(option: Any) -> str:
    """Return advice about an option with an empty value."""
    return f"give {option.metavar or 'one of the choices'}" + ", or leave it out" * (not option.required)


def _is_plain(value: Any) -> bool:
    return isinstance(value, str | int | float) and not isinstance(value, bool)


def _in_brackets(verb: Verb) -> str:
    return f"[{'.'.join(verb)}]"


def _guess(name: str, known: Iterable[str]) -> str:
    """Return a suggestion for a misspelt name; the known names if none is close."""
    known = sorted(known)
    if asked := meant(name, known):
        return asked
    return f"; choose from {', '.join(known)}" if known else ""


def load_found(ctx: typer.Context, path: Path | None, environment: Mapping[str, str]) -> dict[str, Found]:
    """Return the values from file and environment for the verb of a context; the environment takes precedence.

    Raise FileError, SettingsError if the file or a variable cannot be used.
    """
    verb = verb_of(ctx)
    found = {} if path is None else from_file(path, ctx.find_root().command)[verb]
    return found | from_environment(verb, ctx.command, environment)


def verb_of(ctx: typer.Context) -> Verb:
    """Return the words of the verb of a context."""
    words: list[str] = []
    context: Any = ctx
    while context.parent is not None:
        words.insert(0, context.info_name)
        context = context.parent
    return tuple(words)


def found_of(ctx: typer.Context) -> dict[str, Found]:
    """Return the values from file and environment, by the parameters' names."""
    found: dict[str, Found] = ctx.meta.get(FOUND, {})
    return found


def config(
    ctx: typer.Context,
    verb: Annotated[
        list[str] | None, typer.Argument(metavar="VERB OPTIONS", help="A verb and its options, as in a real run.")
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

    Without a verb, print the values from file and environment for all verbs. HAPTICNET_ variables that set
    nothing are reported as warnings.
    """
    from hapticnet.cli.console import Console, print_table

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
    elif rows:
        verbs = len({row["verb"] for row in rows})
        print_table(
            (f"{row['verb']} " * (verbs > 1) + f"--{row['option']}", row["value"], row["source"]) for row in rows
        )
    else:
        print("neither a file nor the environment sets an option; hapticnet config VERB lists the defaults")


def _resolve(root: Any, arguments: list[str], file: Path | None) -> list[dict[str, Any]]:
    """Return the options of the verb that the arguments start with, as a run with these arguments would see them."""
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
