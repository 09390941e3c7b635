"""The codecs by name. A later codec joins by being listed in `CODECS`."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Final

from hapticnet.codec.base import Codec
from hapticnet.codec.deadband import Deadband
from hapticnet.codec.raw import Raw
from hapticnet.errors import SettingsError
from hapticnet.perception import WeberLaw

CODECS: Final[Mapping[str, Callable[..., Codec]]] = {codec.name: codec for codec in (Raw, Deadband)}


def make_codec(name: str, law: WeberLaw, parameters: Mapping[str, float] | None = None) -> Codec:
    """Return the codec called `name` for a person whose perception follows `law`.

    Raises
    ------
    SettingsError
        When no codec has that name, or the codec has no such parameter; the message lists what there is.
    """
    if name not in CODECS:
        raise SettingsError(f"unknown codec {name!r}; there are: {', '.join(CODECS)}")
    codec = CODECS[name](law=law)
    known = codec_parameters(codec)
    for key in parameters or {}:
        if key not in known:
            raise SettingsError(f"codec {name!r} has no parameter {key!r}; it has: {', '.join(known) or 'none'}")
    return CODECS[name](law=law, **(parameters or {}))


def codec_parameters(codec: Codec) -> dict[str, float]:
    """Return the negotiable parameters of a codec by name."""
    return {field.name: getattr(codec, field.name) for field in dataclasses.fields(codec) if field.name != "law"}
