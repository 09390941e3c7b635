"""Times of a recording: which column has them, in which unit, and the times of a constant rate."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import SettingsError
from hapticnet.recordings.columns import TIME_UNITS, factor_of, split_unit

NO_STAMP: Final = int(np.datetime64("NaT").astype(np.int64))
"""Represents a missing stamp, as in NumPy."""

_NAMES: Final = ("t", "time", "timestamp", "time_stamp", "datetime", "date_time", "stamp", "elapsed", "elapsed_time")
_STAMP: Final = re.compile(r"\s*(?:\d{4}-?\d{2}-?\d{2}[T ]\d{2}|\d{2}:\d{2}:)[\d:.,]*\s*(?:Z|[+-][\d:]+)?\s*")
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND: Final = timedelta(microseconds=1)

_UNITS: Final = (("s", "seconds"), ("ms", "milliseconds"), ("us", "microseconds"), ("ns", "nanoseconds"))

# Range of stamps since 1970: the years 1985 to 2128.
_EARLIEST_S, _LATEST_S = 5e8, 5e9

# Longest median step for which a time without a unit is read in s, ms and µs: 2 Hz, 10 Hz and 10 Hz.
_LONGEST_STEPS: Final = (0.5, 100.0, 1e5)


def find_times(names: Sequence[str]) -> int | None:
    """Return the column that has the times: one whose name has a unit of time first; None if there is none."""
    candidates = []
    for index, name in enumerate(names):
        base, unit, in_brackets = split_unit(name)
        known = factor_of(unit, TIME_UNITS) is not None
        stem = base if known or in_brackets else name
        if stem.strip().lower().replace(" ", "_").rpartition(".")[2] in _NAMES:
            candidates.append((not known, index))
    return min(candidates)[1] if candidates else None


def times_us(name: str, values: FloatArray) -> tuple[FloatArray, str | None]:
    """Return times in µs, shape (n,), and a note if the unit was found from the numbers.

    A unit in the column's name is obeyed. Without one, numbers of the size of a time since 1970 are read as that, in
    s, ms, µs or ns; others in the first of s, ms, µs and ns in which the median step is at most 0.5 s, 0.1 s or 0.1 s.

    Raises
    ------
    SettingsError
        If the name has a unit in brackets that is not one of time.
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
    for unit, word in _UNITS:
        in_seconds = TIME_UNITS[unit] * 1e-6
        if _EARLIEST_S <= first * in_seconds <= _LATEST_S and step * in_seconds <= _LONGEST_STEPS[0]:
            return values * TIME_UNITS[unit], f'column "{name}": read as {word} since 1970'
    unit, word = _UNITS[sum(step > longest for longest in _LONGEST_STEPS)]
    rate = f", {1e6 / (step * TIME_UNITS[unit]):.4g} samples a second" if step else ""
    return values * TIME_UNITS[unit], f'column "{name}" has no unit: read as {word}{rate}'


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a date and time in ISO 8601."""
    return len(cell) < 64 and _STAMP.fullmatch(cell) is not None and stamp_us(cell) is not None


def stamp_us(cell: str) -> int | None:
    """Return a date and time in ISO 8601 as µs since 1970, or a time of day as µs since midnight.

    A stamp without a zone is in UTC. An empty cell gives `NO_STAMP`, anything else None.
    """
    cell = cell.strip()
    if not cell:
        return NO_STAMP
    try:
        stamp = datetime.fromisoformat(f"1970-01-01T{cell}" if cell[2:3] == ":" else cell)
    except ValueError:
        return None
    return ((stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)) - _EPOCH) // _MICROSECOND
