"""Values of options from a configuration file and from the environment."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import typer

from hapticnet.checks import meant
from hapticnet.errors import SettingsError

PREFIX: Final = "HAPTICNET_"  # start of the names of environment variables
CONFIG_VARIABLE: Final = "HAPTICNET_CONFIG"  # environment variable that names the configuration file
FOUND: Final = "hapticnet.found"  # where a context keeps what file and environment set
UNSETTABLE: Final = {"help", "config"}  # options that are given on the command line only
FLAGS: Final = {  # what the environment may set a flag to
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


def unknown_variables(verb: Verb, command: Any, environment: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for each environment variable that looks like an option of a verb but is not."""
    start = variable(verb, "")
    known = [variable(verb, key) for key in settable(command)]
    for name in environment:
        if name.startswith(start) and name not in known:
            guess = _guess(name, known)
            yield f"the environment variable {name} is ignored: {' '.join(verb)} has no such option{guess}"


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
