"""Codecs and networks of a study: what a run needs of them, in a form that a worker of another machine can be sent."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, Final, Literal, TypeAlias

from hapticnet.channel.settings import ChannelSettings
from hapticnet.channel.spec import parse_channel
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters, make_codec, parse_codec, split_codec
from hapticnet.experiment.comparison import codec_label
from hapticnet.experiment.grid import LAW_KEYS, grid_codecs
from hapticnet.perception import WeberLaw
from hapticnet.sweep.study import LinkAxes

Kind: TypeAlias = Literal["int", "float", "text"]
Columns: TypeAlias = dict[str, Kind]
"""Names and types of the columns of a table."""

Row: TypeAlias = dict[str, Any]
"""One run: a value, or None, for each column."""

PARAMETER: Final = "parameter_"
"""Start of the names of columns with parameters of codecs."""


@dataclass(frozen=True, slots=True)
class Coder:
    """A codec as a worker makes it.

    Attributes
    ----------
    source
        What names it: a name, ``FILE.py:CLASS`` or ``package.module:CLASS``.
    parameters
        All of its parameters.
    label
        The codec with the parameters that differ from their defaults.
    """

    source: str
    name: str
    label: str
    law: WeberLaw
    parameters: tuple[tuple[str, float], ...]

    def make(self) -> Codec:
        """Return the codec. A user's class is imported."""
        name, _ = parse_codec(self.source)
        return make_codec(name, self.law, dict(self.parameters))

    @property
    def text(self) -> str:
        """The codec as written for ``--codec``."""
        values = ",".join(f"{key}={value!r}" for key, value in self.parameters)
        return f"{self.source}:{values}" if values else self.source

    def row(self, swept: tuple[str, ...]) -> Row:
        """Return the columns of `coder_columns`."""
        own = dict(self.parameters)
        return {
            "codec": self.name,
            "label": self.label,
            "multiplier": self.law.multiplier,
            "weber_fraction": self.law.weber_fraction,
            "floor_n": self.law.floor_n,
            **{f"{PARAMETER}{key}": own.get(key) for key in swept},
        }


def coder_columns(swept: tuple[str, ...]) -> Columns:
    """Return the columns of a codec and of the parameters that a study varies."""
    own: Columns = {f"{PARAMETER}{key}": "float" for key in swept}
    law: Columns = dict.fromkeys(LAW_KEYS, "float")
    return {"codec": "text", "label": "text", **law, **own}


def coders(axes: LinkAxes) -> tuple[Coder, ...]:
    """Return the codecs of a study with each of their laws and parameters.

    Raises
    ------
    SettingsError
        If a codec cannot be made, or none of them has a parameter.
    """
    sources = {parse_codec(text)[0]: split_codec(text)[0] for text in axes.codec}
    laws = {key: getattr(axes, key) for key in LAW_KEYS}
    return tuple(
        Coder(
            source=sources[codec.name],
            name=codec.name,
            label=codec_label(codec),
            law=codec.law,
            parameters=tuple(codec_parameters(codec).items()),
        )
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


LINK_COLUMNS: Final[Columns] = {
    "forward": "text",
    "feedback": "text",
    "delay_ms": "float",
    "jitter_ms": "float",
    "loss": "float",
}


def links(axes: LinkAxes) -> tuple[Link, ...]:
    """Return every combination of the networks of a study.

    Raises
    ------
    SettingsError
        If a part is given both by ``forward`` or ``feedback`` and by an axis of its own.
    """
    return tuple(
        Link(parse_channel(",".join([forward, *parts])), parse_channel(",".join([feedback, *parts])))
        for forward, feedback in product(axes.forward, axes.feedback)
        for parts in _parts(axes)
    )


def _parts(axes: LinkAxes) -> Iterator[list[str]]:
    given = [
        [f"{key}={value}" for value in values]
        for key, values in (("delay", axes.delay), ("jitter", axes.jitter), ("loss", axes.loss))
        if values is not None
    ]
    yield from map(list, product(*given))
