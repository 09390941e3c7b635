"""The parts of a run that are sent to a worker: a codec, the networks, and the source of forces."""

import dataclasses
import hashlib
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from hapticnet.channel.settings import ChannelSettings
from hapticnet.channel.spec import parse_channel
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters, make_codec, parse_codec, split_codec
from hapticnet.errors import SettingsError
from hapticnet.experiment.comparison import codec_label
from hapticnet.experiment.grid import LAW_KEYS, grid_codecs
from hapticnet.experiment.trials import Trial, check_lasts, scene_trial
from hapticnet.files import MAX_BYTES
from hapticnet.operator.scripted import InsertionSettings, PalpatingOperator, PalpationSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.recordings.loading import load_recording
from hapticnet.scene.sources import find_scene, make_scene
from hapticnet.sweep.runs import Columns, Row
from hapticnet.sweep.study import Axes, Reading

PARAMETER: Final = "parameter_"  # prefix of the columns with parameters of codecs

LINK_COLUMNS: Final[Columns] = {
    "forward": "text", "feedback": "text", "delay_ms": "float", "jitter_ms": "float", "loss": "float",
}  # fmt: skip
SOURCE_COLUMNS: Final[Columns] = {"source": "text", "hand": "text", "rate_hz": "float"}

HANDS: Final[dict[str, type[InsertionSettings] | type[PalpationSettings]]] = {
    "scripted": InsertionSettings,
    "palpation": PalpationSettings,
}


@dataclass(frozen=True, slots=True)
class Coder:
    """A codec that a worker can make; `source` is its name, or ``FILE.py:CLASS`` or ``package.module:CLASS``."""

    source: str
    name: str
    label: str
    law: WeberLaw
    parameters: tuple[tuple[str, float], ...]

    def make(self) -> Codec:
        """Return the codec. A user's class is imported."""
        return make_codec(parse_codec(self.source)[0], self.law, dict(self.parameters))

    @property
    def text(self) -> str:
        """The codec as written for ``--codec``."""
        values = ",".join(f"{key}={value!r}" for key, value in self.parameters)
        return f"{self.source}:{values}" if values else self.source

    def row(self, swept: tuple[str, ...]) -> Row:
        """Return the columns of `coder_columns`."""
        law = {key: getattr(self.law, key) for key in LAW_KEYS}
        own = dict(self.parameters)
        return {"codec": self.name, "label": self.label, **law, **{f"{PARAMETER}{key}": own.get(key) for key in swept}}


def coder_columns(swept: tuple[str, ...]) -> Columns:
    """Return the columns of a codec and of the parameters that a study varies."""
    numbers: Columns = dict.fromkeys((*LAW_KEYS, *(f"{PARAMETER}{key}" for key in swept)), "float")
    return {"codec": "text", "label": "text", **numbers}


def coders(axes: Axes) -> tuple[Coder, ...]:
    """Return the codecs of a study with each of their laws and parameters; SettingsError if one cannot be made."""
    sources = {parse_codec(text)[0]: split_codec(text)[0] for text in axes.codec}
    laws = {key: getattr(axes, key) for key in LAW_KEYS}
    return tuple(
        Coder(sources[codec.name], codec.name, codec_label(codec), codec.law, tuple(codec_parameters(codec).items()))
        for codec in grid_codecs(axes.codec, laws | axes.parameters)
    )


@dataclass(frozen=True, slots=True)
class Link:
    """The networks from master to slave and back."""

    forward: ChannelSettings
    feedback: ChannelSettings

    def row(self) -> Row:
        """Return the columns of `LINK_COLUMNS`."""
        jitter, loss = self.feedback.jitter, self.feedback.loss
        return {
            "forward": self.forward.describe(),
            "feedback": self.feedback.describe(),
            "delay_ms": self.feedback.delay_us / 1e3,
            "jitter_ms": 0.0 if jitter is None else jitter.deviation_us / 1e3,
            "loss": 0.0 if loss is None else loss.mean,
        }


def links(axes: Axes) -> tuple[Link, ...]:
    """Return every combination of the networks of a study; SettingsError if a part of one is given twice."""
    given = (("delay", axes.delay), ("jitter", axes.jitter), ("loss", axes.loss))
    parts = [[f"{key}={value}" for value in values] for key, values in given if values is not None]
    return tuple(
        Link(parse_channel(",".join([forward, *each])), parse_channel(",".join([feedback, *each])))
        for forward, feedback in product(axes.forward, axes.feedback)
        for each in product(*parts)
    )


@dataclass(frozen=True, slots=True)
class Touched:
    """A scene of tissues or bodies that a scripted hand touches. Every repeat has a new motion."""

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
        """Return everything that determines the numbers, for JSON."""
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
        """Return everything that determines the numbers, for JSON."""
        trial, parts = self.recorded, hashlib.sha256()
        for array in (trial.t_us, trial.stimuli, trial.positions):
            parts.update(b"none" if array is None else repr(array.shape).encode() + array.tobytes())
        return parts.hexdigest()


Source: TypeAlias = Touched | Recorded


def touched(scene: str, hand: str | None, rate_hz: float, folder: Path) -> Touched:
    """Return a scene, whose path is relative to `folder`, and the hand (with ``:KEY=VALUE,…``) that touches it.

    None: the hand that suits the scene, once. SettingsError for a wrong value; FileError for a bad file.
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
    """Return a recording; raise FileError if the file cannot be used."""
    options = reading.model_dump(exclude={"column"})
    found = load_recording(path, columns=reading.column, max_bytes=MAX_BYTES, **options)
    check_lasts(path, found.t_us)
    return Recorded(Trial(name=name, t_us=found.t_us, stimuli=found.force, positions=found.position))


def _motion(text: str) -> InsertionSettings | PalpationSettings:
    name, _, given = text.partition(":")
    if name == "hand":
        raise SettingsError(
            f"axes: {text!r} moves with the force, and a sweep replays one motion for every codec; use hapticnet"
            " stability, or virtual_link(operator=…) for each run"
        )
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
