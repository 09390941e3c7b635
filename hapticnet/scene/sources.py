"""Sources of a slave's scenes, as named by ``--scene``.

A scene file is TOML. It has a ``name`` and either a ``[[tissue]]`` table for each tissue, or ``[[plane]]`` and
``[[sphere]]`` tables for bodies on two or three axes. The keys of a table are the attributes of `Tissue`, `Plane` or
`Sphere`. A table ``[follower]`` has the attributes of `FollowerSettings`.
"""

import dataclasses
import re
import weakref
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticnet.checks import meant
from hapticnet.errors import FileError, SettingsError
from hapticnet.files import user_path
from hapticnet.plain_datagrams import is_program
from hapticnet.recordings.loading import Columns, load_recording
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.scene.base import UserScene, vibration_method
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.follower import Follower
from hapticnet.scene.recorded import RecordedScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import (
    AnySceneSettings,
    BodySceneSettings,
    FollowerSettings,
    Plane,
    SceneSettings,
    Sphere,
    Tissue,
)
from hapticnet.user_code import close_user_object, find_user_class

if TYPE_CHECKING:
    from hapticnet.scene.base import HasStep, Touchable
    from hapticnet.user_code import UserClass

PAPER_BREACH_FORCES_N: Final = (2.0, 3.5, 5.0)
"""Breach forces [N] of the three tissues of "Cutaneous haptic deadband compression"."""

PAPER_GAP_M: Final = 20e-3
"""Distance [m] between surfaces, and in front of the first. The paper states none: an assumption."""

_PRESETS: Final = files("hapticnet.scene") / "presets"


def paper_scene(seed: int) -> SceneSettings:
    """Return the paper's three tissues, with their breach forces in an order drawn from `seed` (0 or above).

    Each is breached at half the distance to the next surface (the last at the same depth), which gives stiffnesses of
    200, 350 and 500 N/m.
    """
    if seed < 0:
        raise SettingsError(f"the seed of the paper's scene is {seed}; it must be a whole number, 0 or greater")
    breach_forces_n = np.random.default_rng(seed).permutation(PAPER_BREACH_FORCES_N).tolist()
    tissues = [
        Tissue(
            name=f"tissue {number}",
            rest_position_m=number * PAPER_GAP_M,
            stiffness_n_per_m=breach_force_n / (PAPER_GAP_M / 2.0),
            breach_force_n=breach_force_n,
        )
        for number, breach_force_n in enumerate(breach_forces_n, start=1)
    ]
    return SceneSettings(name=f"paper:{seed}", tissues=tuple(tissues))


def scene_names() -> list[str]:
    """Return the names of the scenes stored as TOML files."""
    return sorted(entry.name.removesuffix(".toml") for entry in _PRESETS.iterdir() if entry.name.endswith(".toml"))


def scene_file(spec: str) -> Path | None:
    """Return the path of the file that `spec` names; None for a built-in scene."""
    path = user_path(spec)
    return path if path.suffix == ".toml" and spec not in scene_names() else None


def find_scene(spec: str, folder: Path = Path()) -> AnySceneSettings:
    """Return the scene named by ``paper``, ``paper:SEED``, a preset's name or the path of a TOML file.

    ``paper`` alone is ``paper:0``. A path is relative to `folder`.

    Raise SettingsError if there is no such scene, or a value is invalid, and FileError if the file is missing,
    unreadable or malformed.
    """
    if spec == "paper" or spec.startswith("paper:"):
        seed = spec.removeprefix("paper").removeprefix(":") if spec != "paper" else "0"
        if not re.fullmatch("[0-9]{1,18}", seed):
            raise SettingsError(f"scene {spec!r}: expected a whole number (0 or greater) as the seed after 'paper:'")
        return paper_scene(int(seed))
    if spec in scene_names():
        return parse_scene((_PRESETS / f"{spec}.toml").read_text(encoding="utf-8"), spec)
    path = scene_file(spec)
    if path is None:
        raise SettingsError(
            f"unknown scene {spec!r}{meant(spec, ['paper', *scene_names()])}; choose from paper, paper:SEED,"
            f" {', '.join(scene_names())}, the path of a .toml file, recording:FILE, udp:[HOST:]PORT, FILE.py:CLASS"
            " or package.module:CLASS"
        )
    from hapticnet.documents import read_document

    return parse_scene(read_document(folder / path), str(folder / path))


def parse_scene(text: str, source: str) -> AnySceneSettings:
    """Return the scene described by `text`; messages name `source` as its origin.

    Raise FileError if the text is not TOML; the message has the line and column, and SettingsError if a key is unknown
    or missing, or a value is invalid.
    """
    from hapticnet.documents import parse_document

    scene = parse_document(text, source, _scene_table())
    bodies = len(scene.plane) + len(scene.sphere)
    if scene.tissue and bodies:
        raise SettingsError(
            f"{source}: {len(scene.tissue)} tissues and {bodies} bodies; a scene has either tissues, which a needle"
            " pierces on one axis, or planes and spheres"
        )
    try:
        follower = None if scene.follower is None else FollowerSettings(**scene.follower.model_dump())
        if bodies:
            planes = [Plane(**plane.model_dump()) for plane in scene.plane]
            spheres = [Sphere(**sphere.model_dump()) for sphere in scene.sphere]
            return BodySceneSettings(name=scene.name, bodies=(*planes, *spheres), follower=follower)
        tissues = tuple(Tissue(**tissue.model_dump()) for tissue in scene.tissue)
        return SceneSettings(name=scene.name, tissues=tissues, follower=follower)
    except SettingsError as error:
        raise SettingsError(f"{source}: {error}") from error


@cache
def _scene_table() -> Any:
    """Return the model of a scene file, whose tables have the fields of the settings as keys."""
    from pydantic import create_model  # here, because it is slow to import, and the paper's scene does not need it

    from hapticnet.documents import STRICT

    tables: dict[str, Any] = {}
    for of in Tissue, Plane, Sphere, FollowerSettings:
        keys: dict[str, Any] = {
            field.name: (
                list[float] if field.type == Vector else field.type,  # TOML has lists
                ... if field.default is dataclasses.MISSING else field.default,
            )
            for field in dataclasses.fields(of)
        }
        table: Any = create_model(of.__name__, __config__=STRICT, **keys)
        tables[of.__name__.lower()] = (list[table], [])
    del tables["followersettings"]
    tables["follower"] = (table | None, None)  # one, not a list
    return create_model("Scene", __config__=STRICT, name=(str, ...), **tables)


MOST_FAULTS: Final = 10  # most exceptions of ``close()`` that are remembered until the end of the run


def make_scene(settings: "AnySceneSettings") -> Scene | BodyScene | Follower:
    """Return a new scene of tissues or bodies, with its follower if it has one."""
    scene: Scene | BodyScene
    if isinstance(settings, BodySceneSettings):
        scene = BodyScene(settings.bodies, name=settings.name)
    else:
        scene = Scene(settings.tissues, name=settings.name)
    return scene if settings.follower is None else Follower(scene, settings.follower)


class SceneSource:
    """Makes a scene for each master. This one makes scenes of tissues or bodies."""

    shared = False  # whether all masters touch the same scene
    vibrates = False  # whether it offers vibration beside force; known after `prepare`

    def __init__(self, settings: "AnySceneSettings", file: Path | None = None) -> None:
        self.name = settings.name
        self.file = file  # file that the source is read from, or None
        self.notes: tuple[str, ...] = ()  # notes for the user about that file
        self.risks: tuple[str, ...] = ()  # warnings for the user
        self._settings = settings

    def prepare(self) -> None:
        """Check now whether a scene can be made; raise SettingsError if not."""
        self.vibrates = vibration_method(self.make()) is not None

    def make(self) -> "Touchable":
        """Return a new scene; raise SettingsError if it cannot be made."""
        return make_scene(self._settings)

    def close(self) -> list[str]:
        """Close the objects made, at the end of the run; return the faults."""
        return []


class UserSource(SceneSource):
    """Makes objects of a user's class: a new one for each master, or one for all if the class says ``shared = True``.

    If an object has a method ``close()``, it is called once no session needs the object any more, at the latest at the
    end of the run.
    """

    def __init__(self, found: "UserClass") -> None:
        self.name = found.source
        self.file = found.file
        self.notes = self.risks = ()
        self._found = found
        self.shared = getattr(found.found, "shared", False) is True
        self._stock: UserScene | None = None
        self._closers: set[weakref.finalize[..., UserScene]] = set()
        self._faults: list[str] = []

    def prepare(self) -> None:
        """Make the object of the first master, so that its faults show at once; raise SettingsError if that fails."""
        self._stock = self._stock or self._make()
        self.name = self._stock.name
        self.vibrates = self._stock.vibration is not None

    def make(self) -> "Touchable":
        """Return the object for a master; raise SettingsError if it cannot be made."""
        made = self._stock or self._make()
        self._stock = made if self.shared else None
        # A slave lets no two sessions touch one scene, so each master gets its own view of a shared object.
        return UserScene(made.touched, self._found.label) if self.shared else made

    def close(self) -> list[str]:
        """Close the objects that are still in use; return their exceptions."""
        for closer in tuple(self._closers):
            closer()
        faults, self._faults = self._faults, []
        return faults

    def _make(self) -> UserScene:
        scene = UserScene(self._found.make(), self._found.label)
        self._closers = {closer for closer in self._closers if closer.alive}
        self._closers.add(weakref.finalize(scene, self._close, scene.touched))
        return scene

    def _close(self, touched: object) -> None:
        fault = close_user_object(touched, self._found.label)
        if fault is not None and len(self._faults) < MOST_FAULTS:
            self._faults.append(fault)


class RecordedSource(SceneSource):
    """Makes scenes that play a recorded force, each from its beginning.

    Raise FileError if the file cannot be read or its force is out of range, SettingsError if more than three columns
    are chosen, and UnavailableError if the package that reads this kind of file is not installed.
    """

    def __init__(self, file: Path, columns: Columns | None = None) -> None:
        recording = load_recording(file, columns=columns)
        for row, axis in np.argwhere(~(np.abs(recording.force) <= LARGEST_COMPONENT))[:1].tolist():
            raise FileError(
                f"{file}: sample {row} is {recording.force[row, axis]} N; it must be within ±{LARGEST_COMPONENT:g} N"
            )
        self.name = f"recording:{file.name}"[:64]
        self.file = file
        self.notes, self.risks = recording.notes, ()
        self.axes = int(recording.force.shape[1])
        self._recording = recording

    def make(self) -> "Touchable":
        """Return a new scene at its beginning."""
        return RecordedScene(self._recording.t_us, self._recording.force, name=self.name)


def find_source(spec: str, folder: Path = Path()) -> SceneSource:
    """Return the source of scenes written as `spec`; a path in it is relative to `folder`.

    A class of the user's is imported, so never call it with text from the network.

    Raise SettingsError if there is no such scene, or it cannot be used, and FileError if its file is missing,
    unreadable or malformed.
    """
    if spec.startswith("recording:"):
        text = spec.removeprefix("recording:")
        place, colon, columns = text.rpartition(":")
        if not colon or (folder / user_path(text)).exists():  # a file may have a colon in its name
            return RecordedSource(folder / user_path(text))
        return RecordedSource(folder / user_path(place), columns)
    if is_program(spec):
        raise SettingsError(f"scene {spec!r} is a program that runs in real time; only a slave can ask it")
    if spec not in scene_names() and not spec.startswith("paper:") and not spec.endswith(".toml"):
        found = find_user_class(spec, "scene", folder)
        if found is not None:
            return UserSource(found)
    file = scene_file(spec)
    return SceneSource(find_scene(spec, folder), None if file is None else folder / file)


def as_touchable(scene: "HasStep") -> "Touchable":
    """Return the scene of a user's object; raise SettingsError if it has no usable ``step``."""
    if isinstance(scene, (Scene, BodyScene, Follower, UserScene)):
        return scene
    if isinstance(scene, type):
        raise SettingsError(f"scene is the class {scene.__name__}; pass an object of it, {scene.__name__}()")
    return UserScene(scene, "scene")
