"""One recording from a file: forces and positions with their times, in SI units, and notes for the user."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Final, Literal

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.checks import check_parameter
from hapticnet.errors import FileError, SettingsError
from hapticnet.files import MAX_BYTES, file_errors, user_path
from hapticnet.recordings.columns import (
    FORCE_UNITS,
    LENGTH_UNITS,
    NO_STAMP,
    find_column,
    find_columns,
    find_times,
    listed,
    scale_of,
    split_unit,
    times_us,
)
from hapticnet.recordings.sources import Source, open_source
from hapticnet.samples import MAX_AXES

Missing = Literal["refuse", "drop", "hold"]
Columns = str | Sequence[str]
SLOWEST_HZ: Final = 1e-3
FASTEST_HZ: Final = 1e6  # time stamps are whole microseconds
SMALLEST_SCALE: Final = 1e-9
LARGEST_SCALE: Final = 1e9  # metres in one unit of position
LATEST_US: Final = 2.0**53  # largest time stamp, 285 years: float64 counts whole microseconds up to here
GAP_STEPS: Final = 5  # a gap is a step in time longer than this many median steps
PEAK_SHARE: Final = 1e-3  # share of the samples that may be peaks, at least one sample
PEAK_RATIO: Final = 10  # ratio of a peak's distance from the median to the others'
FEWEST_SAMPLES: Final = 10  # fewer samples are not searched for peaks


@dataclass(frozen=True, slots=True)
class Motion:
    """A recorded motion; its fields are as in `Recording`."""

    t_us: IntArray
    position: FloatArray
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Recording:
    """A recorded force, and its motion if it was read."""

    t_us: IntArray
    """Sampling times [µs], shape (n,), n ≥ 1, as in the file: stamps since 1970 are kept."""
    force: FloatArray
    """Force [N], finite, shape (n, a) with 1 ≤ a ≤ 3."""
    position: FloatArray | None
    """Position [m], finite, shape (n, a); None if not requested."""
    names: tuple[str, ...]
    """Names of the a force columns."""
    notes: tuple[str, ...]
    """Notes for the user, one sentence each: how times were read, units that were scaled, missing values, gaps,
    repeated stamps, peaks."""


def load_recording(
    path: str | PathLike[str],
    *,
    columns: Columns | None = None,
    position: Columns | None = None,
    position_scale: float | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
    missing: Missing = "refuse",
    max_bytes: int = MAX_BYTES,
) -> Recording:
    """Read a force, and its positions if there are any, from a CSV, TSV, .npy, .npz or .mat file.

    Times come from the column `time`, or else from one called t, time or timestamp, with or without a unit (``t_us``,
    ``time [ms]``), as numbers or as dates and times in ISO 8601; without such a column, from `rate_hz`. Units in names
    (``Fx (mN)``, ``x [mm]``, ``pos_mm``) are obeyed.

    Parameters
    ----------
    columns
        One to three force columns, by name (with or without unit), by the name of a two-dimensional array, or by
        number from 0; a string is split at commas. None: those called force (or received, in a recording of a
        master), or else the only column that is not time.
    position
        Position columns, one for each force column. None: those called position or pos, if there is one for each
        force column and no value is missing in them.
    position_scale
        Metres in one unit of position, instead of the unit in the name; negative if positions increase in the
        direction in which a positive force pushes.
    time
        Column of the times, by name or number. None: see above.
    rate_hz
        Sampling rate [Hz] of a file without times. A file with times keeps its own, and a note says so.
    missing
        What to do with rows in which a value is empty or NaN: refuse the file, drop the rows, or hold the last value.
    max_bytes
        Size limit of the file and of its unpacked contents [B].

    Raises
    ------
    FileError
        If the file cannot be read or used; the message names line or row and column where there is one.
    SettingsError
        If an argument is out of range, a column is named twice, or the numbers of force and position columns differ.
    UnavailableError
        If the package that reads this kind of file is not installed.
    """
    source = _open(user_path(path), rate_hz, missing, max_bytes)
    with file_errors(source.path):
        time_at = _times(source, time)
        force_at = _choose(source, columns, "force", time_at)
        if position is not None:
            position_at = _choose(source, position, "position", time_at)
        else:
            named = _named(source.names, _others(source, time_at), "position")
            position_at = named if len(named) == len(force_at) and not set(named) & set(force_at) else []
        if time is None and rate_hz is not None and time_at in (*force_at, *position_at):
            time_at = None  # such as a torque t
        _check_apart(source, {"time": [time_at], "force": force_at, "position": position_at})
        if position_at and len(position_at) != len(force_at):
            raise SettingsError(
                f"{len(position_at)} position columns for {len(force_at)} force columns; the counts must match"
            )
        t_us, force, moved, notes = _read(
            source, time_at, force_at, position_at, position_scale, rate_hz, missing, whole_position=position is None
        )
    if position_scale is not None and not position_at:
        raise SettingsError(
            "--position-scale (position_scale=) applies to --position-column, which is not given (position=), and no"
            " column is called position"
        )
    position_at = position_at[: moved.shape[1]]
    notes = (*notes, *_choice_note(source, columns, "force", force_at, time_at))
    if position_at:
        notes = (*notes, *_choice_note(source, position, "position", position_at, time_at))
    names = tuple(source.names[index] for index in force_at)
    if columns is None and any("received" in name for name in names):
        notes = (*notes, f"no true force; {', '.join(names)} is what a master received, compressed already")
    return Recording(t_us=t_us, force=force, position=moved if position_at else None, names=names, notes=notes)


def load_motion(
    path: str | PathLike[str],
    *,
    position: Columns | None = None,
    position_scale: float | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
    missing: Missing = "refuse",
    max_bytes: int = MAX_BYTES,
) -> Motion:
    """Read positions only: one to three columns, by default those called position or pos; else as `load_recording`."""
    source = _open(user_path(path), rate_hz, missing, max_bytes)
    with file_errors(source.path):
        time_at = _times(source, time)
        chosen = _choose(source, position, "position", time_at)
        if time is None and rate_hz is not None and time_at in chosen:
            time_at = None
        _check_apart(source, {"time": [time_at], "position": chosen})
        t_us, _, moved, notes = _read(source, time_at, [], chosen, position_scale, rate_hz, missing)
    notes = (*notes, *_choice_note(source, position, "position", chosen, time_at))
    return Motion(t_us=t_us, position=moved, notes=notes)


def _open(path: Path, rate_hz: float | None, missing: str, max_bytes: int) -> Source:
    if rate_hz is not None:
        check_parameter("rate", rate_hz, SLOWEST_HZ, FASTEST_HZ, "Hz")
    if missing not in ("refuse", "drop", "hold"):
        raise SettingsError(f"missing is {missing!r}; it must be refuse, drop or hold")
    return open_source(path, max_bytes)


def _times(source: Source, time: str | None) -> int | None:
    return find_times(source.names) if time is None else find_column(source.path, source.names, time)


def _choose(source: Source, columns: Columns | None, what: str, time_at: int | None) -> list[int]:
    """Return the requested columns, or the only possible ones."""
    if isinstance(columns, str):
        columns = [name.strip() for name in columns.split(",")]
    if columns is not None:
        chosen = [index for name in columns for index in find_columns(source.path, source.names, name)]
    else:
        others = _others(source, time_at)
        named = _named(source.names, others, what)
        chosen = named or others
        if len(chosen) != 1 and not named:
            raise FileError(f"{source.path}: which column? {listed(source.names)}; choose one to three of them")
    if not 1 <= len(chosen) <= MAX_AXES:
        raise SettingsError(f"{len(chosen)} {what} columns are chosen; a signal has 1 to {MAX_AXES}")
    return chosen


def _others(source: Source, time_at: int | None) -> list[int]:
    return [index for index, name in enumerate(source.names) if index != time_at and name]


def _choice_note(
    source: Source, columns: Columns | None, what: str, chosen: list[int], time_at: int | None
) -> list[str]:
    if columns is not None or len(_others(source, time_at)) == 1:
        return []
    names = ", ".join(source.names[index] for index in chosen)
    return [f"{what}: {names}, chosen by {'its name' if len(chosen) == 1 else 'their names'}"]


def _check_apart(source: Source, uses: Mapping[str, Sequence[int | None]]) -> None:
    """Raise SettingsError if a column is used for two things, or twice for one."""
    used: dict[int, str] = {}
    for what, indices in uses.items():
        for index in indices:
            if index is None:
                continue
            if index in used:
                told = f"{what} twice" if used[index] == what else f"{used[index]} and as {what}"
                other = "; name another column of times with --time-column (time=)" if used[index] == "time" else ""
                raise SettingsError(f'{source.path}: column "{source.names[index]}" is taken as {told}{other}')
            used[index] = what


def _named(names: Sequence[str], others: list[int], what: str) -> list[int]:
    """Return the columns named after a quantity, such as position_m, pos_x [mm], run.position.0; force_n, force_x_n."""
    for word in ("pos(ition)?",) if what == "position" else ("force", "received"):
        pattern = re.compile(rf"(^|\.){word}([_. ].*)?$")
        named = [index for index in others if pattern.search(split_unit(names[index])[0].lower())]
        if named and (what == "position" or len(named) <= MAX_AXES):
            return named
    return []


def _read(
    source: Source,
    time_at: int | None,
    force_at: list[int],
    position_at: list[int],
    position_scale: float | None,
    rate_hz: float | None,
    missing: Missing,
    *,
    whole_position: bool = False,
) -> tuple[IntArray, FloatArray, FloatArray, tuple[str, ...]]:
    """Return times [µs], forces [N], positions [m] (none if `whole_position` and a value is missing), and notes."""
    indices = [*force_at, *position_at]
    times, values, read_notes = _numbers(source, time_at, indices, rate_hz)
    if whole_position and np.isnan(values[:, len(force_at) :]).any():
        names = ", ".join(source.names[index] for index in position_at)
        read_notes = [*read_notes, f"position: {names} lack values and are not used"]
        indices, position_at, values = force_at, [], values[:, : len(force_at)]
    units = [scale_of(source.names[index], FORCE_UNITS, "N") for index in force_at]
    if position_scale is None:
        units += [scale_of(source.names[index], LENGTH_UNITS, "m") for index in position_at]
    else:
        check_parameter("size of --position-scale", abs(position_scale), SMALLEST_SCALE, LARGEST_SCALE)
        units += [(position_scale, None) for _ in position_at]
    times, values, missing_notes = _without_missing(source, time_at, indices, times, values, missing)
    if np.abs(times).max() > LATEST_US:
        raise FileError(
            f"{source.path}: times up to {np.abs(times).max() / 1e6:g} s; the limit is {LATEST_US / 1e6:g} s"
        )
    t_us = np.round(times).astype(np.int64)
    backwards = np.flatnonzero(np.diff(t_us) < 0)
    if len(backwards):
        before, after = t_us[backwards[0]] / 1e6, t_us[backwards[0] + 1] / 1e6
        raise FileError(
            f"{source.path}: time runs backwards {len(backwards)} times, first at sample {backwards[0] + 1} from"
            f" {before:.6f} s to {after:.6f} s; samples must be in order"
        )
    values = values * np.array([scale for scale, _ in units])
    force = np.ascontiguousarray(values[:, : len(force_at)])
    position = np.ascontiguousarray(values[:, len(force_at) :])
    peaks = (_peak_note(force, "force", "N"), _peak_note(position, "position", "m"))
    notes = [*source.notes, *read_notes, *(note for _, note in units), *missing_notes, *time_notes(t_us), *peaks]
    return t_us, force, position, tuple(note for note in notes if note)


def _numbers(
    source: Source, time_at: int | None, indices: list[int], rate_hz: float | None
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Return times [µs], shape (n,), columns, shape (n, k), NaN where a value is missing, and notes."""
    if time_at is None:
        if rate_hz is None:
            raise FileError(
                f"{source.path}: no column is called t, time or timestamp (such as t_s or time [ms]); rename the column"
                " of times, or name it with --time-column (time=), or give the rate with --sampling-rate (rate_hz=);"
                f" {listed(source.names)}"
            )
        values = source.numbers(indices)
        return np.arange(len(values), dtype=np.float64) * (1e6 / rate_hz), values, []
    name = source.names[time_at]
    notes = [] if rate_hz is None else [f'column "{name}" has the times; --sampling-rate {rate_hz:g} is not used']
    if source.has_stamps(time_at):
        stamps = source.stamps_us(time_at)
        t_us = np.where(stamps == NO_STAMP, np.nan, stamps.astype(np.float64))
        return t_us, source.numbers(indices), notes
    values = source.numbers([time_at, *indices])
    try:
        t_us, note = times_us(name, values[:, 0])
    except SettingsError as error:
        raise FileError(f"{source.path}: {error}") from None
    return t_us, values[:, 1:], notes + ([note] if note else [])


def _without_missing(
    source: Source, time_at: int | None, indices: list[int], t_us: FloatArray, values: FloatArray, missing: Missing
) -> tuple[FloatArray, FloatArray, list[str]]:
    absent = np.isnan(values)
    timeless = np.isnan(t_us)
    faulty = absent.any(axis=1) | timeless
    count = int(faulty.sum())
    if not count:
        return t_us, values, []
    if missing == "refuse":
        row = int(np.argmax(faulty))
        index = time_at if timeless[row] and time_at is not None else indices[int(np.argmax(absent[row]))]
        raise FileError(
            f'{source.path}, {source.place(row)}, column "{source.names[index]}": no number; {count} of {len(values)}'
            " rows lack one; use --missing drop (missing=) to leave them out, or hold to repeat the last value"
        )
    if missing == "drop":
        kept = ~faulty
        note = f"{count} of {len(values)} rows with missing values are left out"
    else:
        # Index of the last row with a value, or -1, for every cell.
        last = np.maximum.accumulate(np.where(absent, -1, np.arange(len(values))[:, np.newaxis]), axis=0)
        kept = (last >= 0).all(axis=1) & ~timeless
        values = np.take_along_axis(values, np.maximum(last, 0), axis=0)
        left = int((~kept).sum())
        note = f"missing values in {count} of {len(values)} rows: the last value is repeated"
        note += f", and {left} rows without a time or an earlier value are left out" if left else ""
    if not kept.any():
        raise FileError(f"{source.path}: every row lacks a value")
    return t_us[kept], values[kept], [note]


def time_notes(t_us: IntArray) -> list[str]:
    """Return notes on the times [µs] of a recording, shape (n,), which do not run backwards."""
    steps = np.diff(t_us)
    notes = []
    repeated = int((steps == 0).sum())
    if repeated:
        notes.append(f"{repeated} of {len(t_us)} samples repeat the time stamp of the sample before")
    rising = steps[steps > 0]
    median_us = float(np.median(rising)) if len(rising) else 0.0
    gaps = np.flatnonzero(steps > GAP_STEPS * median_us) if len(rising) else rising
    if len(gaps):
        longest = int(gaps[np.argmax(steps[gaps])])
        notes.append(
            f"{len(gaps)} {'gap' if len(gaps) == 1 else 'gaps'} in time (more than {GAP_STEPS} times the median step of"
            f" {median_us / 1e3:g} ms), the longest {steps[longest] / 1e6:g} s after sample {longest}"
        )
    return notes


def _peak_note(values: FloatArray, what: str, unit: str) -> str | None:
    """Return a note on outliers among values of shape (n, a); None if there are none.

    With m = `PEAK_SHARE` · n rounded down, but at least 1, a peak is a value whose distance from the median of its axis
    is more than `PEAK_RATIO` times the (m + 1)-th largest such distance. So at most m samples of an axis are peaks,
    peaks of any size do not hide each other, and a contact that lasts for more than m samples is not a peak.
    """
    if len(values) < FEWEST_SAMPLES or not values.shape[1]:
        return None
    rest_at = len(values) - 1 - max(1, int(len(values) * PEAK_SHARE))
    distance = np.abs(values - np.median(values, axis=0))
    outside = distance > PEAK_RATIO * np.partition(distance, rest_at, axis=0)[rest_at]
    rows = np.flatnonzero(outside.any(axis=1))
    if not len(rows):
        return None
    row = int(rows[np.argmax(np.where(outside, distance, 0.0)[rows].max(axis=1))])
    axis = int(np.argmax(np.where(outside, distance, 0.0)[row]))
    rest = np.delete(values[:, axis], rows)
    return (
        f"{what}: {len(rows)} {'sample is' if len(rows) == 1 else 'samples are'} far outside the rest, up to"
        f" {values[row, axis]:g} {unit} at sample {row}; the rest is between {rest.min():g} and {rest.max():g} {unit}"
    )
