"""Columns of a recording: how they are chosen, and the units that their names carry."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from hapticnet.errors import FileError

FORCE_UNITS: Final = {
    "N": 1.0,
    "mN": 1e-3,
    "uN": 1e-6,
    "µN": 1e-6,
    "kN": 1e3,
    "gf": 9.80665e-3,
    "kgf": 9.80665,
    "lbf": 4.4482216152605,
}
"""Newtons in a unit of force. Gram-force, kilogram-force and pound-force as in NIST SP 811, appendix B."""

LENGTH_UNITS: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "nm": 1e-9, "in": 0.0254}
"""Metres in a unit of length."""

TIME_UNITS: Final = {
    "s": 1e6,
    "sec": 1e6,
    "seconds": 1e6,
    "ms": 1e3,
    "us": 1.0,
    "µs": 1.0,
    "ns": 1e-3,
}
"""Microseconds in a unit of time."""

OTHER_UNITS: Final = ("rad", "deg", "°", "V", "mV", "Nm", "mNm", "counts", "adc", "raw", "Pa", "kPa", "bar", "g")
"""Units of other quantities, which are named in a note when a force or position column carries one."""

_AMBIGUOUS: Final = ("MN", "Mm", "Ms")  # capitals may mean mega, so these are not read in lower case
_BRACKETED: Final = re.compile(r"(.*?)[\s_]*[\[(]\s*([^\[\]()]*?)\s*[\])]")
_SUFFIXED: Final = re.compile(r"(.*[^\s_/])(?:_|\s*/\s*|\s+)([A-Za-zµ°]+)")
_LONGEST_WITH_UNIT: Final = 200
_SHOWN_NAMES: Final = 20
_SHOWN_CHARACTERS: Final = 60


def split_unit(name: str) -> tuple[str, str, bool]:
    """Return a column's name without unit, what may be its unit ("" if there is none), and whether in brackets."""
    name = name.strip().replace("\N{GREEK SMALL LETTER MU}", "\N{MICRO SIGN}")
    if len(name) > _LONGEST_WITH_UNIT:  # the expressions below take quadratic time
        return name, "", False
    match = _BRACKETED.fullmatch(name)
    if match:
        return match[1], match[2], True
    match = _SUFFIXED.fullmatch(name)
    return (match[1], match[2], False) if match else (name, "", False)


def factor_of(unit: str, units: Mapping[str, float]) -> float | None:
    """Return the size of a unit, in any case that is not ambiguous; None if `units` does not have it."""
    if unit in units:
        return units[unit]
    lowered = {known.lower(): factor for known, factor in units.items()}
    return None if unit in _AMBIGUOUS else lowered.get(unit.lower())


def scale_of(name: str, units: Mapping[str, float], si_unit: str) -> tuple[float, str | None]:
    """Return how many SI units one unit of a column is, and a note for the user if that is not certainly 1."""
    _, unit, in_brackets = split_unit(name)
    factor = factor_of(unit, units) if unit else 1.0
    # A suffix that is no known unit is a part of the name: force_left. In brackets it claims to be a unit.
    if factor is None:
        if in_brackets or unit in OTHER_UNITS:
            return 1.0, f'column "{name}": "{unit}" is not a known unit of this quantity; values are taken as {si_unit}'
        return 1.0, None
    return factor, f'column "{name}": scaled by {factor:g} to {si_unit}' if factor != 1.0 else None


def find_columns(path: Path, names: Sequence[str], wanted: str) -> list[int]:
    """Return the columns that `wanted` means: one, or all columns of an array of that name.

    In this order: a column of exactly that name; the columns NAME.0, NAME.1, … of a two-dimensional array; a column
    that has this name before its unit; the column of that number, from 0.

    Raises
    ------
    FileError
        If there is no such column, or several.
    """
    exact = [index for index, name in enumerate(names) if name == wanted]
    array = [index for index, name in enumerate(names) if re.fullmatch(re.escape(wanted) + r"\.\d+", name)]
    if not exact and array:
        return array
    matches = exact or [index for index, name in enumerate(names) if wanted and split_unit(name)[0] == wanted]
    if len(matches) == 1:
        return matches
    if matches:
        raise FileError(
            f'{path}: {len(matches)} columns are called "{wanted}"; choose one by its number, 0 to {len(names) - 1}'
        )
    if wanted.isdecimal() and wanted.isascii() and len(wanted) < 10 and int(wanted) < len(names):
        return [int(wanted)]
    raise FileError(f'{path}: no column "{wanted}"; {listed(names)}')


def find_column(path: Path, names: Sequence[str], wanted: str) -> int:
    """Return the one column that `wanted` means; see `find_columns`."""
    found = find_columns(path, names, wanted)
    if len(found) > 1:
        raise FileError(f'{path}: "{wanted}" has {len(found)} columns; choose one, such as {names[found[0]]}')
    return found[0]


def listed(names: Sequence[str]) -> str:
    """Return the columns of a file as part of a message."""
    more = f", … {len(names) - _SHOWN_NAMES} more" if len(names) > _SHOWN_NAMES else ""
    shown = ", ".join(name[:_SHOWN_CHARACTERS] for name in names[:_SHOWN_NAMES])
    return f"there are {shown}{more} (or numbers 0 to {len(names) - 1})"


def printable(text: str) -> str:
    """Return text from a file for a name or a message, without control characters, which could act on a terminal."""
    return "".join(character if character.isprintable() else "?" for character in text.strip())
