"""The codecs by name. A later codec joins by being listed in `CODECS`."""

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any, Final

from hapticnet.codec.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.base import Codec
from hapticnet.codec.deadband import Deadband
from hapticnet.codec.least_squares import LeastSquares
from hapticnet.codec.level_crossing import LevelCrossing
from hapticnet.codec.merging import Merging
from hapticnet.codec.passive import PassiveExtrapolative, PassiveInterpolative
from hapticnet.codec.predictive import LinearPredictive
from hapticnet.codec.probabilistic import Probabilistic
from hapticnet.codec.raw import Raw
from hapticnet.codec.velocity_adaptive import VelocityAdaptive
from hapticnet.errors import SettingsError
from hapticnet.perception import WeberLaw

CODECS: Final[Mapping[str, type[Any]]] = {
    codec.name: codec
    for codec in (
        Raw,
        Deadband,
        AdaptivePredictive,
        LinearPredictive,
        LeastSquares,
        LevelCrossing,
        VelocityAdaptive,
        PassiveExtrapolative,
        PassiveInterpolative,
        Probabilistic,
        Merging,
    )
}


def make_codec(name: str, law: WeberLaw, parameters: Mapping[str, float] | None = None) -> Codec:
    """Return the codec called `name` for a person whose perception follows `law`.

    Raises
    ------
    SettingsError
        When no codec has that name, or the codec has no such parameter; the message lists what there is.
    """
    if name not in CODECS:
        raise SettingsError(f"unknown codec {name!r}; there are: {', '.join(CODECS)}")
    known = [field.name for field in dataclasses.fields(CODECS[name]) if field.name != "law"]
    for key in parameters or {}:
        if key not in known:
            raise SettingsError(f"codec {name!r} has no parameter {key!r}; it has: {', '.join(known) or 'none'}")
    made: Codec = CODECS[name](law=law, **(parameters or {}))
    return made


def parse_codec(text: str) -> tuple[str, dict[str, float]]:
    """Return name and parameters of a codec written as ``NAME[:KEY=VALUE,…]``.

    Raises
    ------
    SettingsError
        When a parameter has not that form, or comes twice.
    """
    name, _, rest = text.partition(":")
    parameters: dict[str, float] = {}
    for part in rest.split(",") if rest else ():
        key, separator, value = part.partition("=")
        key = key.strip()
        try:
            number = float(value)
        except ValueError:
            number = None
        if not separator or number is None or key in parameters:
            raise SettingsError(
                f"codec {text!r}: {part!r} must be KEY=NUMBER, each key once, as in deadband:step_n=0.001"
            )
        parameters[key] = number
    return name.strip(), parameters


def describe_codecs() -> list[dict[str, Any]]:
    """Return name, rule and parameters of every codec, for a person or for JSON."""
    described = []
    for name, codec in CODECS.items():
        meanings = _attributes(inspect.getdoc(codec) or "")
        described.append(
            {
                "name": name,
                "summary": (inspect.getdoc(codec) or "").partition("\n")[0],
                "needs_position": codec.needs_position,
                "parameters": [
                    {"name": key, "default": value, "meaning": meanings[key]}
                    for key, value in codec_parameters(codec()).items()
                ],
            }
        )
    return described


def _attributes(docstring: str) -> dict[str, str]:
    """Return what the Attributes section of a numpydoc docstring says of each name."""
    meanings: dict[str, str] = {}
    name = ""
    for line in docstring.partition("Attributes\n----------\n")[2].splitlines():
        if line and not line.startswith(" "):
            if line.startswith("-") or line in ("Raises", "Examples"):
                break
            name = line.strip()
        elif name:
            meanings[name] = f"{meanings.get(name, '')} {line.strip()}".strip()
    return meanings


def codec_parameters(codec: Codec) -> dict[str, float]:
    """Return the negotiable parameters of a codec by name."""
    return {field.name: getattr(codec, field.name) for field in dataclasses.fields(codec) if field.name != "law"}
