"""Columns of a recording: their selection, the units in their names, and the column of times."""

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import FileError, SettingsError

FORCE_UNITS: Final = {  # newtons; gram-force, kilogram-force and pound-force as in NIST SP 811, appendix B
    "N": 1.0,
    "mN": 1e-3,
    "uN": 1e-6,
    "µN": 1e-6,
    "kN": 1e3,
    "gf": 9.80665e-3,
    "kgf": 9.80665,
    "lbf": 4.4482216152605,
}
LENGTH_UNITS: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "nm": 1e-9, "in": 0.0254}  # metres
TIME_UNITS: Final = {"s": 1e6, "sec": 1e6, "seconds": 1e6, "ms": 1e3, "us": 1.0, "µs": 1.0, "ns": 1e-3}  # µs
# Units of other quantities, which are named in a note when a force or position column carries one.
OTHER_UNITS: Final = ("rad", "deg", "°", "V", "mV", "Nm", "mNm", "counts", "adc", "raw", "Pa", "kPa", "bar", "g")
MOST_COLUMNS: Final = 10_000  # most columns of a table, in a file of any kind, and most arrays in an archive
NO_STAMP: Final = int(np.datetime64("NaT").astype(np.int64))  # represents a missing stamp, as in NumPy

_TIME_NAMES: Final = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "datetime",
    "date_time",
    "stamp",
    "elapsed",
    "elapsed_time",
)
_STAMP: Final = re.compile(r"\s*(?:\d{4}-?\d{2}-?\d{2}[T ]\d{2}|\d{2}:\d{2}:)[\d:.,]*\s*(?:Z|[+-][\d:]+)?\s*")
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND: Final = timedelta(microseconds=1)
_WORDS: Final = (("s", "seconds"), ("ms", "milliseconds"), ("us", "microseconds"), ("ns", "nanoseconds"))

# Range of stamps since 1970: the years 1985 to 2128.
_EARLIEST_S, _LATEST_S = 5e8, 5e9

# Longest median step for which a time without a unit is read in s, ms and µs: 2 Hz, 10 Hz and 10 Hz.
_LONGEST_STEPS: Final = (0.5, 100.0, 1e5)
_AMBIGUOUS: Final = ("MN", "Mm", "Ms")  # capitals may mean mega, so these are case-sensitive
_BRACKETED: Final = re.compile(r"(.*?)[\s_]*[\[(]\s*([^\[\]()]*?)\s*[\])]")
_SUFFIXED: Final = re.compile(r"(.*[^\s_/])(?:_|\s*/\s*|\s+)([A-Za-zµ°]+)")
_LONGEST_WITH_UNIT: Final = 200
_SHOWN_NAMES: Final = 20
_SHOWN_CHARACTERS: Final = 60


def split_unit(name: str) -> tuple[str, str, bool]:
    """Return a column's name without unit, its possible unit ("" if none), and whether that is in brackets."""
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
    """Return the SI value of one unit of a column, and a note for the user unless it is certainly 1."""
    _, unit, in_brackets = split_unit(name)
    factor = factor_of(unit, units) if unit else 1.0
    # A suffix that is not a known unit is part of the name: force_left. In brackets it claims to be a unit.
    if factor is None:
        if in_brackets or unit in OTHER_UNITS:
            return 1.0, f'column "{name}": "{unit}" is not a known unit of this quantity; values are taken as {si_unit}'
        return 1.0, None
    return factor, f'column "{name}": scaled by {factor:g} to {si_unit}' if factor != 1.0 else None


def find_columns(path: Path, names: Sequence[str], wanted: str) -> list[int]:
    """Return the columns that `wanted` selects: one, or all columns of an array of that name.

    In this order: a column of exactly that name; the columns NAME.0, NAME.1, … of a two-dimensional array; a column
    that has this name before its unit; the column of that number, from 0. Raise FileError if there is none, or several.
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
    """Return the one column that `wanted` selects; see `find_columns`."""
    found = find_columns(path, names, wanted)
    if len(found) > 1:
        raise FileError(f'{path}: "{wanted}" has {len(found)} columns; choose one, such as {names[found[0]]}')
    return found[0]


def listed(names: Sequence[str]) -> str:
    """Return the columns of a file as part of a message."""
    more = f", … {len(names) - _SHOWN_NAMES} more" if len(names) > _SHOWN_NAMES else ""
    shown = ", ".join(name[:_SHOWN_CHARACTERS] for name in names[:_SHOWN_NAMES])
    return f"there are {shown}{more} (or numbers 0 to {len(names) - 1})"


def check_columns(path: Path, count: int) -> None:
    """Raise FileError if a table has more columns than are read."""
    if count > MOST_COLUMNS:
        raise FileError(f"{path}: {count:,} columns; the limit is {MOST_COLUMNS:,}")


def find_times(names: Sequence[str]) -> int | None:
    """Return the column that has the times: one whose name has a unit of time first; None if there is none."""
    candidates = []
    for index, name in enumerate(names):
        base, unit, in_brackets = split_unit(name)
        known = factor_of(unit, TIME_UNITS) is not None
        stem = base if known or in_brackets else name
        if stem.strip().lower().replace(" ", "_").rpartition(".")[2] in _TIME_NAMES:
            candidates.append((not known, index))
    return min(candidates)[1] if candidates else None


def times_us(name: str, values: FloatArray) -> tuple[FloatArray, str | None]:
    """Return times in µs, shape (n,), and a note if the unit was found from the numbers.

    A unit in the column's name is obeyed; SettingsError if it is in brackets but not of time. Without one, numbers
    of the size of a time since 1970 are read as that, in s, ms, µs or ns; others in the first of s, ms, µs and ns in
    which the median step is at most 0.5 s, 0.1 s or 0.1 s.
    """
    _, unit, in_brackets = split_unit(name)
    factor = factor_of(unit, TIME_UNITS)
    if factor is not None:
        return values * factor, None
    if in_brackets:
        raise SettingsError(f'column "{name}": "{unit}" is not a known unit of time; known are {", ".join(TIME_UNITS)}')
    finite = values[np.isfinite(values)]
    steps = np.abs(np.diff(finite))
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    first = abs(float(finite[0])) if len(finite) else 0.0
    for unit, word in _WORDS:
        in_seconds = TIME_UNITS[unit] * 1e-6
        if _EARLIEST_S <= first * in_seconds <= _LATEST_S and step * in_seconds <= _LONGEST_STEPS[0]:
            return values * TIME_UNITS[unit], f'column "{name}": read as {word} since 1970'
    unit, word = _WORDS[sum(step > longest for longest in _LONGEST_STEPS)]
    rate = f", {1e6 / (step * TIME_UNITS[unit]):.4g} samples a second" if step else ""
    return values * TIME_UNITS[unit], f'column "{name}" has no unit: read as {word}{rate}'


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a date and time in ISO 8601."""
    return len(cell) < 64 and _STAMP.fullmatch(cell) is not None and stamp_us(cell) is not None


def stamp_us(cell: str) -> int | None:
    """Return ISO 8601 as µs since 1970 (UTC without a zone) or midnight; `NO_STAMP` if empty, None if invalid."""
    cell = cell.strip()
    if not cell:
        return NO_STAMP
    try:
        stamp = datetime.fromisoformat(f"1970-01-01T{cell}" if cell[2:3] == ":" else cell)
    except ValueError:
        return None
    return ((stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)) - _EPOCH) // _MICROSECOND
