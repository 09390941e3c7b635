"""Scenes as TOML files.

A file has a ``name`` and either a ``[[tissue]]`` table for each tissue, or ``[[plane]]`` and ``[[sphere]]`` tables for
bodies on two or three axes. The keys of a table are the attributes of `Tissue`, `Plane` or `Sphere`.
"""

import dataclasses
from pathlib import Path
from typing import Any, Final, TypeAlias

from pydantic import BaseModel, create_model

from hapticnet.documents import STRICT, parse_document, read_document
from hapticnet.errors import SettingsError
from hapticnet.samples import Vector
from hapticnet.scene.body import BodySceneSettings, Plane, Sphere
from hapticnet.scene.tissue import SceneSettings, Tissue

AnySceneSettings: TypeAlias = SceneSettings | BodySceneSettings


def _keys(of: type[Any]) -> dict[str, Any]:
    """Return the keys of a table and their types; TOML has lists where settings have vectors."""
    return {
        field.name: (
            list[float] if field.type == Vector else field.type,
            ... if field.default is dataclasses.MISSING else field.default,
        )
        for field in dataclasses.fields(of)
    }


_TissueTable: Final[Any] = create_model("Tissue", __config__=STRICT, **_keys(Tissue))
_PlaneTable: Final[Any] = create_model("Plane", __config__=STRICT, **_keys(Plane))
_SphereTable: Final[Any] = create_model("Sphere", __config__=STRICT, **_keys(Sphere))


class _SceneTable(BaseModel):
    model_config = STRICT

    name: str
    tissue: list[_TissueTable] = []
    plane: list[_PlaneTable] = []
    sphere: list[_SphereTable] = []


def load_scene(path: Path) -> AnySceneSettings:
    """Return the scene described by a TOML file.

    Raises
    ------
    FileError
        If the file is missing, unreadable or not TOML.
    SettingsError
        If a key is unknown or missing, or a value is invalid.
    """
    return parse_scene(read_document(path), str(path))


def parse_scene(text: str, source: str) -> AnySceneSettings:
    """Return the scene described by `text`; messages name `source` as its origin.

    Raises
    ------
    FileError
        If the text is not TOML; the message has the line and column.
    SettingsError
        If a key is unknown or missing, or a value is invalid.
    """
    scene = parse_document(text, source, _SceneTable)
    bodies = len(scene.plane) + len(scene.sphere)
    if scene.tissue and bodies:
        raise SettingsError(
            f"{source}: {len(scene.tissue)} tissues and {bodies} bodies; a scene has either tissues, which a needle"
            " pierces on one axis, or planes and spheres"
        )
    try:
        if bodies:
            planes = [Plane(**plane.model_dump()) for plane in scene.plane]
            spheres = [Sphere(**sphere.model_dump()) for sphere in scene.sphere]
            return BodySceneSettings(name=scene.name, bodies=(*planes, *spheres))
        return SceneSettings(name=scene.name, tissues=tuple(Tissue(**tissue.model_dump()) for tissue in scene.tissue))
    except SettingsError as error:
        raise SettingsError(f"{source}: {error}") from error
