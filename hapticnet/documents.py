"""TOML files that people write: read, parsed and checked; each mistake is one line that says what would be right."""

import reprlib
import tomllib
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from hapticnet.errors import FileError, SettingsError

STRICT: Final = ConfigDict(extra="forbid", strict=True)
"""What the model of a document is configured with: no unknown keys, nothing taken for what it is not."""

_WANTED: Final = {
    "string_type": "text in quotes",
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
}
"""What pydantic's commonest complaints come to, by its names for them."""

Document = TypeVar("Document", bound=BaseModel)


def read_document(path: Path) -> str:
    """Return the text of a file; a FileError says why it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text: byte {error.start} is 0x{error.object[error.start]:02x}") from error


def parse_document(text: str, source: str, model: type[Document]) -> Document:
    """Return the document that `text`, which came from `source`, is by its model.

    Raises
    ------
    FileError
        When the text is not TOML; the message has the line and column.
    SettingsError
        When a key is unknown or missing, or a value is not of its kind; the message names the key.
    """
    try:
        # Beside its own error tomllib lets through what int() and the recursion limit refuse.
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{source}: not a TOML file: {_with_place(str(error), text)}") from error
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise SettingsError(f"{source}: {_first_mistake(error, model)}") from error


def _with_place(message: str, text: str) -> str:
    """Return tomllib's message with the line and column it leaves out at the end of a document."""
    line = text.count("\n") + 1
    column = len(text) - text.rfind("\n")
    return message.replace("(at end of document)", f"(at line {line}, column {column}, the end of the document)")


def _first_mistake(error: ValidationError, model: type[BaseModel]) -> str:
    """Return in one line where the first mistake is and what would be right."""
    # A misspelt key is both unknown and missing; unknown says more.
    mistake = min(error.errors(include_url=False), key=lambda each: each["type"] != "extra_forbidden")
    table, where, key = _place(model, mistake["loc"])
    if mistake["type"] == "extra_forbidden":
        return f"{where}unknown key {key!r}; the keys are {', '.join(table.model_fields)}"
    if mistake["type"] == "missing":
        return f"{where}{key} is missing"
    wanted = _WANTED.get(mistake["type"])
    right = f"it must be {wanted}" if wanted else f"{mistake['msg'][0].lower()}{mistake['msg'][1:]}"
    return f"{where}{key} is {reprlib.repr(mistake['input'])}; {right}"


def _place(model: type[BaseModel], location: tuple[int | str, ...]) -> tuple[type[BaseModel], str, str]:
    """Return the table a mistake is in, which of several it is ("tissue 2: "), and the key within ("finger.date")."""
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
    return model, where, key or "the table"


def _table_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model of a table, an optional table or a list of tables; None for anything else."""
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None
