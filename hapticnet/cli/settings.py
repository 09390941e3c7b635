"""Values of a master's and a slave's options from a configuration file."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

from hapticnet.checks import meant
from hapticnet.errors import SettingsError

UNSETTABLE: Final = {"help", "config"}  # options that are given on the command line only

Verb: TypeAlias = tuple[str, ...]  # the words of a verb, such as ("device", "step")


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


def from_file(path: Path, commands: Mapping[str, Any]) -> dict[str, dict[str, str | bool | list[str]]]:
    """Return the values in a configuration file as on the command line, by verb and by the parameters' names.

    Raise FileError if the file cannot be read or is not TOML; SettingsError if a table or key is unknown, or a value
    has the wrong type.
    """
    from hapticnet.documents import parse_tables, read_document

    found: dict[str, dict[str, str | bool | list[str]]] = {verb: {} for verb in commands}
    for verb, table in parse_tables(read_document(path), str(path)).items():
        if verb not in commands or not isinstance(table, dict):
            raise SettingsError(f"{path}: unknown table [{verb}]{_guess(verb, commands)}")
        options = {option_key(each): each for each in commands[verb].params if option_key(each) not in UNSETTABLE}
        for key, value in table.items():
            if key not in options:
                raise SettingsError(f"{path}: [{verb}] unknown key {key!r}{_guess(key, options)}")
            found[verb][options[key].name] = _checked(value, options[key], f"{path}: [{verb}] {key}")
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


def _guess(name: str, known: Iterable[str]) -> str:
    """Return a suggestion for a misspelt name; the known names if none is close."""
    known = sorted(known)
    return meant(name, known) or f"; choose from {', '.join(known)}"
