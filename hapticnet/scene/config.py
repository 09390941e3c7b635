"""Scenes as TOML files.

A file has a ``name`` and one ``[[tissue]]`` table for each tissue; its keys are the attributes of `Tissue`.
"""

import dataclasses
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, create_model

from hapticnet.documents import STRICT, parse_document, read_document
from hapticnet.errors import SettingsError
from hapticnet.scene.tissue import SceneSettings, Tissue

_TISSUE_KEYS: Final[dict[str, Any]] = {
    field.name: (field.type, ... if field.default is dataclasses.MISSING else field.default)
    for field in dataclasses.fields(Tissue)
}

_TissueTable: Any = create_model("Tissue", __config__=STRICT, **_TISSUE_KEYS)


class _SceneTable(BaseModel):
    model_config = STRICT

    name: str
    tissue: list[_TissueTable]


def load_scene(path: Path) -> SceneSettings:
    """Return the scene described by a TOML file.

    Raises
    ------
    FileError
        If the file is missing, unreadable or not TOML.
    SettingsError
        If a key is unknown or missing, or a value is invalid.
    """
    return parse_scene(read_document(path), str(path))


def parse_scene(text: str, source: str) -> SceneSettings:
    """Return the scene described by `text`; messages name `source` as its origin.

    Raises
    ------
    FileError
        If the text is not TOML; the message has the line and column.
    SettingsError
        If a key is unknown or missing, or a value is invalid.
    """
    scene = parse_document(text, source, _SceneTable)
    try:
        return SceneSettings(name=scene.name, tissues=tuple(Tissue(**tissue.model_dump()) for tissue in scene.tissue))
    except SettingsError as error:
        raise SettingsError(f"{source}: {error}") from error
