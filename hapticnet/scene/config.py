"""Scenes as TOML files.

A file has a ``name`` and one ``[[tissue]]`` table per tissue, whose keys are the attributes of `Tissue`.
"""

import dataclasses
import reprlib
import tomllib
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from hapticnet.errors import FileError, SettingsError
from hapticnet.scene.tissue import SceneSettings, Tissue

_STRICT: Final = ConfigDict(extra="forbid", strict=True)

_TISSUE_KEYS: Final[dict[str, Any]] = {
    field.name: (field.type, ... if field.default is dataclasses.MISSING else field.default)
    for field in dataclasses.fields(Tissue)
}

_TissueTable: Any = create_model("Tissue", __config__=_STRICT, **_TISSUE_KEYS)


class _SceneTable(BaseModel):
    model_config = _STRICT

    name: str
    tissue: list[_TissueTable]


def load_scene(path: Path) -> SceneSettings:
    """Return the scene described by a TOML file.

    Raises
    ------
    FileError
        When the file is missing, unreadable or not TOML.
    SettingsError
        When a key is unknown or missing, or a value cannot be used.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text: byte {error.start} is 0x{error.object[error.start]:02x}") from error
    return parse_scene(text, str(path))


def parse_scene(text: str, source: str) -> SceneSettings:
    """Return the scene described by `text`, which came from `source`.

    Raises
    ------
    FileError
        When the text is not TOML; the message has the line and column.
    SettingsError
        When a key is unknown or missing, or a value cannot be used.
    """
    try:
        # Beside its own error tomllib lets through what int() and the recursion limit refuse.
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{source}: not a TOML file: {_with_place(str(error), text)}") from error
    try:
        scene = _SceneTable.model_validate(table)
        return SceneSettings(name=scene.name, tissues=tuple(Tissue(**tissue.model_dump()) for tissue in scene.tissue))
    except ValidationError as error:
        raise SettingsError(f"{source}: {_first_mistake(error)}") from error
    except SettingsError as error:
        raise SettingsError(f"{source}: {error}") from error


def _with_place(message: str, text: str) -> str:
    """Return tomllib's message with the line and column it leaves out at the end of a document."""
    line = text.count("\n") + 1
    column = len(text) - text.rfind("\n")
    return message.replace("(at end of document)", f"(at line {line}, column {column}, the end of the document)")


def _first_mistake(error: ValidationError) -> str:
    """Return in one line where the first mistake is and what would be right."""
    mistake = error.errors(include_url=False)[0]
    match mistake["loc"]:
        case ("tissue", int(index), *keys):
            where, model = f"tissue {index + 1}: ", _TissueTable
        case keys:
            where, model = "", _SceneTable
    key = keys[0] if keys else "the table"
    if mistake["type"] == "extra_forbidden":
        return f"{where}unknown key {key!r}; the keys are {', '.join(model.model_fields)}"
    if mistake["type"] == "missing":
        return f"{where}{key} is missing"
    return f"{where}{key} is {reprlib.repr(mistake['input'])}; {mistake['msg'][0].lower()}{mistake['msg'][1:]}"
