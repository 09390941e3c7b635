"""Where the scenes of a slave come from, as ``--scene`` names them: tissues, bodies, recordings, or a user's class."""

import weakref
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hapticnet.errors import SettingsError
from hapticnet.files import user_path
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.body import BodySceneSettings
from hapticnet.scene.presets import find_scene, scene_file, scene_names
from hapticnet.scene.recorded import RecordedForce
from hapticnet.scene.scene import Scene
from hapticnet.scene.user import UserScene
from hapticnet.user_code import close_user_object, find_user_class

if TYPE_CHECKING:
    from hapticnet.scene.base import Touchable
    from hapticnet.scene.config import AnySceneSettings
    from hapticnet.scene.user import HasStep
    from hapticnet.user_code import UserClass

SCENES: Final = "paper, paper:SEED, a preset, FILE.toml, recording:FILE, FILE.py:CLASS or package.module:CLASS"
"""What ``--scene`` may be."""

MOST_FAULTS: Final = 10
"""Most exceptions of ``close()`` that are remembered until the end of the run."""


def make_scene(settings: "AnySceneSettings") -> Scene | BodyScene:
    """Return a new scene of tissues or bodies."""
    if isinstance(settings, BodySceneSettings):
        return BodyScene(settings.bodies, name=settings.name)
    return Scene(settings.tissues, name=settings.name)


class SceneSource:
    """Makes a scene for each master. This one makes scenes of tissues or bodies.

    Attributes
    ----------
    name
        Name of the scenes.
    file
        File that the source is read from, or None.
    notes
        What the user should know about that file.
    """

    def __init__(self, settings: "AnySceneSettings", file: Path | None = None) -> None:
        self.name = settings.name
        self.file = file
        self.notes: tuple[str, ...] = ()
        self._settings = settings

    @property
    def shared(self) -> bool:
        """Whether all masters touch the same scene."""
        return False

    def prepare(self) -> None:
        """Find out now whether a scene can be made; raise SettingsError if not."""

    def make(self) -> "Touchable":
        """Return a new scene; raise SettingsError if it cannot be made."""
        return make_scene(self._settings)

    def close(self) -> list[str]:
        """Close what was made, at the end of the run; return what went wrong."""
        return []


class UserSource(SceneSource):
    """Makes objects of a user's class: a new one for each master, or one for all if the class says ``shared = True``.

    If an object has a method ``close()``, it is called once no session needs the object any more, at the latest at the
    end of the run.
    """

    def __init__(self, found: "UserClass") -> None:
        self.name = found.source
        self.file = found.file
        self.notes = ()
        self._found = found
        self._shared = getattr(found.found, "shared", False) is True
        self._stock: UserScene | None = None
        self._closers: set[weakref.finalize[..., UserScene]] = set()
        self._faults: list[str] = []

    @property
    def shared(self) -> bool:
        """Whether all masters touch the same object."""
        return self._shared

    def prepare(self) -> None:
        """Make the object of the first master, so that its mistakes show at once; raise SettingsError if that fails."""
        self._stock = self._stock or self._make()
        self.name = self._stock.name

    def make(self) -> "Touchable":
        """Return the object for a master; raise SettingsError if it cannot be made."""
        made = self._stock or self._make()
        self._stock = made if self._shared else None
        # A slave lets no two sessions touch one scene, so each master gets its own view of a shared object.
        return UserScene(made.touched, self._found.label) if self._shared else made

    def close(self) -> list[str]:
        """Close the objects that are still in use; return what they raised."""
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
    """Makes scenes that play a recorded force, of FILE or FILE:COLUMN,…; a file may have a colon in its name."""

    def __init__(self, spec: str, folder: Path) -> None:
        file, colon, columns = spec.rpartition(":")
        chosen = bool(colon) and not (folder / user_path(spec)).exists()
        self.file = folder / user_path(file if chosen else spec)
        self._force = RecordedForce(self.file, columns=columns if chosen else None)
        self.name = self._force.name
        self.notes = self._force.notes

    def make(self) -> "Touchable":
        """Return a scene that has not begun."""
        return self._force.make()


def find_source(spec: str, folder: Path = Path()) -> SceneSource:
    """Return the source of scenes written as `spec`; a path in it is relative to `folder`.

    A class of the user's is imported, so never call it with text from the network.

    Raises
    ------
    SettingsError
        If there is no such scene, or it cannot be used.
    FileError
        If its file is missing, unreadable or malformed.
    """
    if spec.startswith("recording:"):
        return RecordedSource(spec.removeprefix("recording:"), folder)
    if spec not in scene_names() and not spec.startswith("paper:") and not spec.endswith(".toml"):
        found = find_user_class(spec, "scene", folder)
        if found is not None:
            return UserSource(found)
    file = scene_file(spec)
    return SceneSource(find_scene(spec, folder), None if file is None else folder / file)


def as_touchable(scene: "HasStep") -> "Touchable":
    """Return what masters touch from an object of a user; raise SettingsError if it has no usable ``step``."""
    if isinstance(scene, (Scene, BodyScene, UserScene)):
        return scene
    if isinstance(scene, type):
        raise SettingsError(f"scene is the class {scene.__name__}; pass an object of it, {scene.__name__}()")
    return UserScene(scene, "scene")
