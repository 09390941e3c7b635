"""Grids of settings, of ``compare --grid`` and of the axes of a study: their values and codecs."""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Final

from hapticnet.checks import check_integer
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters, make_codec, parse_codec
from hapticnet.errors import SettingsError
from hapticnet.perception import WeberLaw

LAW_KEYS: Final = ("multiplier", "weber_fraction", "floor_n")
LOSS_KEY: Final = "loss"
MOST_VALUES: Final = 1000


def spread(first: float, last: float, count: int, *, in_ratios: bool = False) -> list[float]:
    """Return values from the first to the last in equal steps, or in equal ratios, if both are above 0."""
    shares = [step / max(count - 1, 1) for step in range(count)]
    if in_ratios:
        values = [first * (last / first) ** share for share in shares]
    else:
        values = [first + (last - first) * share for share in shares]
    # Twelve digits, so that a range has 0.3 in it and not 0.30000000000000004.
    return [float(f"{value:.12g}") for value in values]


def parse_grid(texts: Sequence[str]) -> dict[str, list[float]]:
    """Return the values of each key of grids written as ``KEY=FROM:TO:COUNT`` (equal steps) or ``KEY=a,b,c``."""
    grid: dict[str, list[float]] = {}
    for text in texts:
        key, _, values = (part.strip() for part in text.partition("="))
        if key in grid:
            raise SettingsError(f"grid {text!r}: {key} is given twice")
        try:
            grid[key] = _values(key, values)
        except ValueError:
            expected = "KEY=FROM:TO:COUNT or KEY=a,b,c, as in multiplier=0.5:4:8"
            raise SettingsError(f"grid {text!r} must have the form {expected}") from None
    return grid


def grid_codecs(names: Sequence[str], grid: Mapping[str, Sequence[float]]) -> list[Codec]:
    """Return the codecs in `names` with every combination of the law and the parameters in a grid; raw only once.

    A parameter applies to the codecs that have it, except where the name itself fixes it; SettingsError if none has it.
    """
    plain = [(name, *parse_codec(name)) for name in dict.fromkeys(names)]
    known = {text: codec_parameters(make_codec(name, WeberLaw(), given)) for text, name, given in plain}
    swept = [key for key in grid if key not in (*LAW_KEYS, LOSS_KEY)]
    for key in swept:
        if not any(key in parameters for parameters in known.values()):
            there = sorted({parameter for parameters in known.values() for parameter in parameters})
            raise SettingsError(
                f"no codec here has a parameter {key!r} for a grid; there are: "
                f"{', '.join([*LAW_KEYS, LOSS_KEY, *there])}"
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


def _values(key: str, text: str) -> list[float]:
    if ":" not in text:
        values = [float(part) for part in text.split(",")]
    else:
        first, last, count = (float(part) for part in text.split(":"))
        check_integer(f"the number of values of {key}", count, 1, MOST_VALUES)
        values = spread(first, last, int(count))
    if not key or not all(map(math.isfinite, values)):
        raise ValueError
    return list(dict.fromkeys(values))
