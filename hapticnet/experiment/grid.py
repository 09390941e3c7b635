"""Grids of settings, as of the axes of a study: their values, and the codecs they stand for."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Final

from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters, make_codec, parse_codec
from hapticnet.errors import SettingsError
from hapticnet.perception import WeberLaw

LAW_KEYS: Final = ("multiplier", "weber_fraction", "floor_n")


def grid_codecs(names: Sequence[str], grid: Mapping[str, Sequence[float]]) -> list[Codec]:
    """Return the codecs in `names` with every combination of the law and the parameters in a grid; raw only once.

    A parameter applies to the codecs that have it, except where the name itself fixes it; SettingsError if none has it.
    """
    plain = [(name, *parse_codec(name)) for name in dict.fromkeys(names)]
    known = {text: codec_parameters(make_codec(name, WeberLaw(), given)) for text, name, given in plain}
    swept = [key for key in grid if key not in LAW_KEYS]
    for key in swept:
        if not any(key in parameters for parameters in known.values()):
            there = sorted({parameter for parameters in known.values() for parameter in parameters})
            raise SettingsError(
                f"no codec here has a parameter {key!r} for a grid; there are: {', '.join([*LAW_KEYS, *there])}"
            )
    law_keys = [key for key in LAW_KEYS if key in grid]
    codecs: list[Codec] = []
    for number, values in enumerate(product(*(grid[key] for key in law_keys))):
        law = WeberLaw(**dict(zip(law_keys, values, strict=True)))
        for text, name, given in plain:
            if name == "raw" and number:
                continue
            own = [key for key in swept if key in known[text] and key not in given]
            for point in product(*(grid[key] for key in own)):
                codec = make_codec(name, law, given | dict(zip(own, point, strict=True)))
                if codec not in codecs:
                    codecs.append(codec)
    return codecs
