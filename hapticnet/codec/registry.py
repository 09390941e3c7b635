"""The codecs by name: hapticnet's own in `CODECS`, and those of users, which `parse_codec` loads."""

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any, Final

from hapticnet.checks import meant
from hapticnet.codec.base import Codec
from hapticnet.codec.parts import codec_of_parts
from hapticnet.codec.plugins import installed_codecs, user_class
from hapticnet.codec.schemes.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.schemes.linear_predictive import LinearPredictive
from hapticnet.codec.schemes.motion_predictive import MotionPredictive
from hapticnet.codec.schemes.raw import Raw
from hapticnet.errors import HapticnetError, SettingsError, in_words
from hapticnet.parts import PartsLaw
from hapticnet.perception import SMALLEST, WeberLaw
from hapticnet.user_code import split_user_code

CODECS: Final[Mapping[str, type[Any]]] = {
    codec.name: codec for codec in (Raw, Deadband, MotionPredictive, AdaptivePredictive, LinearPredictive)
}


_user_codecs: dict[str, type[Any]] = {}


def all_codecs() -> Mapping[str, type[Any]]:
    """Return hapticnet's codecs and the user codecs registered so far, by name."""
    return {**CODECS, **_user_codecs}


def make_codec(name: str, law: WeberLaw, parameters: Mapping[str, float] | None = None) -> Codec:
    """Return the codec called `name` for a person whose perception follows `law`.

    With the law of several parts, it is one such codec for each. Nothing is imported here: the name may come from the
    network. Raise SettingsError if no codec has that name or the
    codec has no such parameter; the message lists the known ones.
    """
    if isinstance(law, PartsLaw):
        if getattr(all_codecs().get(name), "renders_model", False):  # made for forces and places, not for torques
            raise SettingsError(f"codec {name!r} renders a model of what is touched, which is for one part only")
        return codec_of_parts(law, [make_codec(name, each, parameters) for each in law.laws])
    made = CODECS.get(name) or _user_codecs.get(name)
    if made is None:
        raise SettingsError(f"unknown codec {name!r}{meant(name, all_codecs())}; there are: {', '.join(all_codecs())}")
    known = [field.name for field in dataclasses.fields(made) if field.name != "law"]
    for key in parameters or {}:
        if key not in known:
            raise SettingsError(
                f"codec {name!r} has no parameter {key!r}{meant(key, known)}; it has: {', '.join(known) or 'none'}"
            )
    try:
        codec: Codec = made(law=law, **(parameters or {}))
    except HapticnetError:
        raise
    except Exception as error:  # a user's codec may raise anything
        given = " ".join(str(dict(parameters or {})).split())
        raise SettingsError(f"codec {name!r} refused {given}: {in_words(error)}") from error
    return codec


def with_share(codec: Codec, share: float) -> Codec:
    """Return the codec with its thresholds reduced by the share that positions use."""
    law = codec.law
    left = law.multiplier and max((1.0 - share) * law.multiplier, SMALLEST)
    return make_codec(codec.name, dataclasses.replace(law, multiplier=left), codec_parameters(codec))


def parse_codec(text: str) -> tuple[str, dict[str, float]]:
    """Return name and parameters of a codec written as ``CODEC[:KEY=VALUE,…]``.

    CODEC is a name, ``FILE.py:Class`` or ``package.module:Class``. The last two, and names that installed packages
    offer as entry points, are imported and registered. Do not call it with text from the network.

    Raise SettingsError if a parameter does not have that form or occurs twice, or a user's codec cannot be used.
    """
    codec, rest = split_codec(text)
    if ":" in codec:
        codec = register_codec(user_class(codec))
    elif codec not in CODECS and codec in (points := installed_codecs()):
        codec = _register_installed(codec, points[codec].value)
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
    return codec, parameters


def split_codec(text: str) -> tuple[str, str]:
    """Return the name of the codec in ``CODEC[:KEY=VALUE,…]``, and its parameters as text."""
    parts = split_user_code(text)
    if parts is not None and text.partition(":")[0].strip() not in CODECS:
        return parts
    name, _, parameters = text.partition(":")
    if name.strip().endswith(".py"):
        raise SettingsError(f"codec {text!r}: name the class in the file too, as in {name.strip()}:MyCodec")
    return name.strip(), parameters


def register_codec(made: type[Any]) -> str:
    """Register a class from `user_class` by its name, and return the name; SettingsError if it is taken."""
    name: str = made.name
    other = CODECS.get(name) or _user_codecs.get(name, made)
    if getattr(other, "origin", None) != made.origin:
        taken = getattr(other, "source", "hapticnet")
        raise SettingsError(f"codec {made.source}: the name {name!r} is taken by {taken}; choose another")
    _user_codecs[name] = made
    return name


def every_codec() -> Mapping[str, type[Any]]:
    """Register the installed codecs that can be used; return all codecs, by name."""
    register_installed_codecs()
    return all_codecs()


def register_installed_codecs() -> list[str]:
    """Register every codec that installed packages offer as an entry point; return the faults of the others."""
    faults = []
    for name, point in installed_codecs().items():
        try:
            _register_installed(name, point.value)
        except SettingsError as error:
            faults.append(str(error))
    return faults


def _register_installed(name: str, source: str) -> str:
    made = user_class(source)
    if made.name != name:
        raise SettingsError(f"codec {source}: its entry point is {name!r} and its name {made.name!r}; make them equal")
    return register_codec(made)


def describe_codecs() -> list[dict[str, Any]]:
    """Return name, rule and parameters of every codec, for a person or for JSON."""
    described = []
    for name, codec in all_codecs().items():
        doc = inspect.getdoc(codec) or ""
        meanings, defaults = _attributes(doc), codec_parameters(codec())
        parameters = [{"name": key, "default": x, "meaning": meanings.get(key, "")} for key, x in defaults.items()]
        summary, needs = doc.partition("\n")[0], codec.needs_position
        described.append({"name": name, "summary": summary, "needs_position": needs, "parameters": parameters})
    return described


def _attributes(docstring: str) -> dict[str, str]:
    """Return the description of each name in the Attributes section of a numpydoc docstring."""
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
