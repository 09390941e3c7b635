"""What is touched in a study of felt forces: scenes with a scripted hand, or recordings."""

import dataclasses
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from hapticnet.errors import FileError, SettingsError
from hapticnet.experiment.scene_force import scene_trial
from hapticnet.experiment.trial import Trial
from hapticnet.files import MAX_BYTES
from hapticnet.operator.scripted import InsertionSettings, PalpatingOperator, PalpationSettings, ScriptedOperator
from hapticnet.recordings.loading import load_recording
from hapticnet.scene.sources import find_scene, make_scene
from hapticnet.sweep.link import Columns, Row
from hapticnet.sweep.study import Reading

HANDS: Final[dict[str, type[InsertionSettings] | type[PalpationSettings]]] = {
    "scripted": InsertionSettings,
    "palpation": PalpationSettings,
}

SOURCE_COLUMNS: Final[Columns] = {"source": "text", "hand": "text", "rate_hz": "float"}


@dataclass(frozen=True, slots=True)
class Touched:
    """A scene that a scripted hand touches. Every repeat has another motion.

    Attributes
    ----------
    scene
        Settings of a scene of tissues or bodies; see `scene.sources.find_scene`.
    hand
        The hand as the study writes it.
    """

    name: str
    scene: Any
    hand: str
    motion: InsertionSettings | PalpationSettings
    rate_hz: float

    def trial(self, rng: np.random.Generator) -> Trial:
        """Return positions and forces of one motion."""
        hand: ScriptedOperator | PalpatingOperator
        if isinstance(self.motion, PalpationSettings):
            hand = PalpatingOperator(self.motion, rng)
        else:
            hand = ScriptedOperator(self.motion, rng)
        return scene_trial(make_scene(self.scene), hand, name=self.name, rate_hz=self.rate_hz)

    def row(self) -> Row:
        """Return the columns of `SOURCE_COLUMNS`."""
        return {"source": self.name, "hand": self.hand, "rate_hz": self.rate_hz}

    def fingerprint(self) -> Any:
        """Return all that determines the numbers, for JSON."""
        return dataclasses.asdict(self)


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recording, the same in every repeat."""

    recorded: Trial

    def trial(self, _rng: np.random.Generator) -> Trial:
        """Return the recording."""
        return self.recorded

    def row(self) -> Row:
        """Return the columns of `SOURCE_COLUMNS`."""
        return {"source": self.recorded.name, "hand": None, "rate_hz": None}

    def fingerprint(self) -> Any:
        """Return all that determines the numbers, for JSON."""
        trial, parts = self.recorded, hashlib.sha256()
        for array in (trial.t_us, trial.stimuli, trial.positions):
            parts.update(b"none" if array is None else repr(array.shape).encode() + array.tobytes())
        return parts.hexdigest()


Source: TypeAlias = Touched | Recorded


def touched(scene: str, hand: str | None, rate_hz: float, folder: Path) -> Touched:
    """Return a scene and the hand that touches it.

    Parameters
    ----------
    hand
        "scripted" or "palpation", or one of them with ``:KEY=VALUE,…``; None: the one that suits the scene, once.
    folder
        What the path of a scene is relative to.

    Raises
    ------
    SettingsError
        If there is no such scene, hand or key, a value is out of range, or hand and scene have different axes.
    FileError
        If the file of the scene cannot be used.
    """
    settings = find_scene(scene, folder)
    axes = make_scene(settings).axes
    if hand is None:
        hand = "scripted:insertions=1" if axes == 1 else f"palpation:axes={axes},palpations=1"
    motion = _motion(hand)
    own = motion.axes if isinstance(motion, PalpationSettings) else 1
    if own != axes:
        other = "palpation" if axes > 1 else "scripted"
        raise SettingsError(f"axes: hand {hand!r} has axes: {own}, and scene {settings.name!r}: {axes}; use {other}")
    if not 10.0 <= rate_hz <= 100_000.0:
        raise SettingsError(f"axes: rate_hz is {rate_hz:g}; it must be between 10 and 100000")
    return Touched(settings.name, settings, hand, motion, rate_hz)


def recorded(path: Path, name: str, reading: Reading) -> Recorded:
    """Return a recording.

    Raises
    ------
    FileError
        If the file cannot be used.
    """
    found = load_recording(
        path,
        columns=reading.column,
        position=reading.position,
        position_scale=reading.position_scale,
        time=reading.time,
        rate_hz=reading.rate_hz,
        missing=reading.missing,
        max_bytes=MAX_BYTES,
    )
    t_us = found.t_us
    if t_us[-1] == t_us[0]:
        raise FileError(f"{path}: {len(t_us)} samples over no time; at least two different times are needed")
    return Recorded(Trial(name=name, t_us=t_us, stimuli=found.force, positions=found.position))


def _motion(text: str) -> InsertionSettings | PalpationSettings:
    name, _, given = text.partition(":")
    if name not in HANDS:
        raise SettingsError(f"axes: hand {text!r} must be {' or '.join(HANDS)}, and may have :KEY=VALUE,…")
    made: Any = HANDS[name]
    kinds: dict[str, Any] = {each.name: each.type for each in dataclasses.fields(made) if each.type in (int, float)}
    values: dict[str, Any] = {}
    for part in filter(None, given.split(",")):
        key, _, value = (each.strip() for each in part.partition("="))
        if key not in kinds:
            raise SettingsError(f"axes: hand {text!r}: there is no {key!r}; there are: {', '.join(kinds)}")
        try:
            values[key] = kinds[key](value)
        except ValueError:
            expected = "a whole number" if kinds[key] is int else "a number"
            raise SettingsError(f"axes: hand {text!r}: {key} is {value!r}; it must be {expected}") from None
    motion: InsertionSettings | PalpationSettings = made(**values)
    return motion
