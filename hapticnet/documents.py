"""Read, parse and validate TOML files; report each mistake in one line that says what is allowed."""

import re
import reprlib
import tomllib
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from hapticnet.checks import meant
from hapticnet.errors import FileError, SettingsError, visible
from hapticnet.files import read_text

LARGEST_DOCUMENT: Final = 4 * 2**20  # size limit of a TOML file [B]; a scene of 10,000 tissues takes 2 MB
MOST_PARTS: Final = 16  # most parts of a dotted key: tomllib's time and memory grow with their square
MOST_PARTS_TOGETHER: Final = 200_000  # most parts of all dotted keys: each takes 1 kB of memory

STRICT: Final = ConfigDict(extra="forbid", strict=True)  # configuration of models: no unknown keys, no conversions

_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")

_EXPECTED: Final = {
    "string_type": "text in quotes",
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "literal_error": "{expected}",
    "finite_number": "a finite number",
    "greater_than": "more than {gt:,}",
    "greater_than_equal": "at least {ge:,}",
    "less_than": "less than {lt:,}",
    "less_than_equal": "at most {le:,}",
    "string_too_short": "text of at least {min_length} characters",
    "string_too_long": "text of at most {max_length} characters",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
}
"""Allowed values, for each of pydantic's error types that our models can cause; pydantic's words are for
programmers."""

WHOLE: Final = "the table"  # error types that concern no single key

_PART: Final = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_DOTTED: Final = re.compile(rf"""(?<![\w"'.\\-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART})++""")
"""A dotted key, or a number. Possessive quantifiers, so that every text takes one pass."""

_PARTS: Final = re.compile(_PART)
_END_OF_KEY: Final = re.compile(r"[ \t]*+[=\]]")

Document = TypeVar("Document", bound=BaseModel)


def text_of(form: str, words: str) -> AfterValidator:
    """Return a check of a whole text's form, which a message describes in words: patterns are for programmers."""
    pattern = re.compile(form)

    def check(text: str) -> str:
        if not pattern.fullmatch(text):
            raise ValueError(f"it must be {words}")
        return text

    return AfterValidator(check)


def read_document(path: Path) -> str:
    """Return the text of a TOML file of at most `LARGEST_DOCUMENT`; raise FileError if it cannot be read as UTF-8."""
    return read_text(path, LARGEST_DOCUMENT)


def parse_tables(text: str, source: str) -> dict[str, Any]:
    """Return the tables of a TOML text; raise FileError with line and column if it is not TOML, or has huge keys."""
    _check_keys(text, source)
    try:
        # tomllib also lets errors of int() and of the recursion limit through.
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{source}: not a TOML file: {_with_place(str(error), text)}") from error
    _check_texts(tables, source)
    return tables


def parse_document(text: str, source: str, model: type[Document], *, context: object = None) -> Document:
    """Return `text` parsed and validated by a model, whose validators get `context`; messages name `source`.

    Raises FileError with line and column if the text is not TOML; SettingsError naming the key if a key is unknown or
    missing, or a value has the wrong type.
    """
    content = parse_tables(text, source)
    try:
        return model.model_validate(content, context=context)
    except ValidationError as error:
        raise SettingsError(f"{source}: {_first_mistake(error, model)}") from error
    except SettingsError as error:  # from the model's own checks
        raise SettingsError(f"{source}: {error}") from error


def _check_keys(text: str, source: str) -> None:
    """Raise FileError if a document of this size could take gigabytes of memory because of its dotted keys."""
    together = 0
    for found in _DOTTED.finditer(text):
        if _END_OF_KEY.match(text, found.end()):
            parts = len(_PARTS.findall(found[0]))
            together += parts
            if parts > MOST_PARTS:
                line = text.count("\n", 0, found.start()) + 1
                raise FileError(f"{source}: line {line} has a key of {parts:,} parts; at most {MOST_PARTS} are read")
            if together > MOST_PARTS_TOGETHER:
                raise FileError(f"{source}: its dotted keys have more than {MOST_PARTS_TOGETHER:,} parts together")


def _check_texts(tables: dict[str, Any], source: str) -> None:
    """Raise FileError if a key or text has control characters, which TOML can escape, except line feeds and tabs."""
    waiting: list[tuple[str, Any]] = [("", tables)]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [(key, key) for key in value] + list(value.items())
        elif isinstance(value, list):
            waiting += [(name, each) for each in value]
        elif isinstance(value, str) and (found := _CONTROL.search(value)):
            raise FileError(f"{source}: {visible(name)!r} has the control character U+{ord(found[0]):04X}; remove it")


def _with_place(message: str, text: str) -> str:
    """Return tomllib's message with the line and column, which it omits at the end of a document."""
    line = text.count("\n") + 1
    column = len(text) - text.rfind("\n")
    return message.replace("(at end of document)", f"(at line {line}, column {column}, the end of the document)")


def _first_mistake(error: ValidationError, model: type[BaseModel]) -> str:
    """Return the place of the first mistake and the allowed values, in one line."""
    # A misspelt key is both unknown and missing; "unknown" is more useful.
    mistake = min(error.errors(include_url=False), key=lambda each: each["type"] != "extra_forbidden")
    table, where, key = _place(model, mistake["loc"])
    # _place() descended into the table's model, so this is a list of tables.
    if mistake["type"] == "list_type" and isinstance(mistake["input"], dict) and table is not model:
        return f"{where}[{key}] is one table; write [[{key}]], with two brackets, above each"
    if mistake["type"] == "extra_forbidden":
        asked = meant(key.rpartition(".")[2], table.model_fields)
        return f"{where}unknown key {key!r}{asked}; the keys are {', '.join(table.model_fields)}"
    if mistake["type"] == "missing":
        return f"{where}{key} is missing"
    if mistake["type"] == "value_error" and isinstance(mistake["input"], dict):  # of a whole table: no single value
        table_name = "" if key == WHOLE else f"{key}: "
        return f"{where}{table_name}{mistake['ctx']['error']}"
    if mistake["type"] == "value_error":  # our own error
        right = str(mistake["ctx"]["error"])
    else:
        right = f"it must be {_EXPECTED.get(mistake['type'], 'something else').format(**mistake.get('ctx', {}))}"
    field = table.model_fields.get(key)
    if field is not None and not field.repr:  # a secret
        return f"{where}{key} is invalid; {right}"
    return f"{where}{key} is {reprlib.repr(mistake['input'])}; {right}"


def _place(model: type[BaseModel], location: tuple[int | str, ...]) -> tuple[type[BaseModel], str, str]:
    """Return the table with the mistake, its number ("tissue 2: ") and the key within it ("finger.date")."""
    where, key, several = "", "", False
    for part in location:
        if isinstance(part, int) and several:  # one table of several
            where, key, several = f"{key} {part + 1}: ", "", False
            continue
        key = f"{key}.{part}" if key else str(part)
        field = model.model_fields.get(str(part))
        table = _table_in(field.annotation) if field is not None else None
        several = table is not None
        model = table or model
    return model, where, key or WHOLE


def _table_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model of a table, an optional table or a list of tables; otherwise None."""
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None
