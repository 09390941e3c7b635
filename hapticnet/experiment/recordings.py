"""Recorded signals from files: CSV or NPY, columns by name or number, time from a column or a rate."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.errors import FileError, SettingsError
from hapticnet.samples import MAX_AXES
from hapticnet.tables import Table, read_csv

TIME_COLUMNS: Final = {"t_us": 1.0, "t_s": 1e6, "time_s": 1e6}
"""Columns that are understood as time, and how many microseconds their unit is."""

SLOWEST_HZ: Final = 1e-3
FASTEST_HZ: Final = 1e6
"""Sampling rates that time stamps of whole microseconds can tell."""

SMALLEST_SCALE: Final = 1e-9
LARGEST_SCALE: Final = 1e9
"""Metres in one unit of position: from nanometres to what no hand moves."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A recorded signal.

    Attributes
    ----------
    t_us
        Sampling times [µs], shape (n,), n ≥ 1.
    values
        The signal in its own unit, finite, shape (n, a) with 1 ≤ a ≤ 3.
    names
        What the a columns are called.
    """

    t_us: npt.NDArray[np.int64]
    values: FloatArray
    names: tuple[str, ...]


def load_recording(file: Path, *, columns: Sequence[str] | None = None, rate_hz: float | None = None) -> Signal:
    """Return a signal from a .csv or .npy file.

    Parameters
    ----------
    columns
        Names or numbers from 0; None: the only column that is not time.
    rate_hz
        Sampling rate [Hz]; None: a column t_us, t_s or time_s tells the time, and must where there is one.

    Raises
    ------
    FileError
        When the file cannot be read or used; names line and column where there are any.
    SettingsError
        When the rate or the number of columns cannot be.
    """
    if rate_hz is not None and not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise SettingsError(f"rate is {rate_hz} Hz; it must be between {SLOWEST_HZ:g} and {FASTEST_HZ:g}")
    source = _NpySource(file) if file.suffix == ".npy" else read_csv(file)
    if columns is None:
        columns = [name for name in source.names if name not in TIME_COLUMNS]
        if len(columns) != 1:
            raise FileError(f"{file}: which column? There are: {', '.join(source.names)}; choose one to three of them")
    if not 1 <= len(columns) <= MAX_AXES:
        raise SettingsError(f"{len(columns)} columns are named; 1 to {MAX_AXES} make a signal")
    values = np.column_stack([source.column(name) for name in columns])
    return Signal(_times(file, source, rate_hz, len(values)), values, tuple(columns))


def load_positions(
    file: Path, columns: str | None, scale: float, *, like: Signal, rate_hz: float | None
) -> FloatArray | None:
    """Return the positions [m] that go with a force, shape (n, a); None where no columns are named.

    Parameters
    ----------
    columns
        Names or numbers from 0, separated by commas, as many as the force has.
    scale
        Metres in one unit of position; negative where it grows the way a positive force pushes.

    Raises
    ------
    FileError
        When the file cannot be used.
    SettingsError
        When there are not as many columns, or the scale cannot be.
    """
    if columns is None:
        if scale != 1.0:
            raise SettingsError("--position-scale says how to read --position, which is not given")
        return None
    if not SMALLEST_SCALE <= abs(scale) <= LARGEST_SCALE:
        raise SettingsError(
            f"--position-scale is {scale}; it must be between {SMALLEST_SCALE:g} and {LARGEST_SCALE:g}, or as far"
            " below 0"
        )
    positions: FloatArray = scale * load_recording(file, columns=columns.split(","), rate_hz=rate_hz).values
    if positions.shape != like.values.shape:
        raise SettingsError(
            f"{positions.shape[1]} position columns for {like.values.shape[1]} of force; as many are needed"
        )
    return positions


class _NpySource:
    """An array in a .npy file as columns: the fields of a structured one, or numbers."""

    def __init__(self, file: Path) -> None:
        try:
            array = np.load(file, allow_pickle=False)
        except OSError as error:
            raise FileError(f"{file}: {error.strerror or 'cannot be read'}") from error
        except Exception as error:  # numpy lets out whatever a damaged header makes its parser raise
            raise FileError(f"{file}: not a .npy file of plain numbers") from error
        if not isinstance(array, np.ndarray):
            raise FileError(f"{file}: an archive of arrays; a .npy file of one is wanted")
        if array.dtype.names:
            self._columns = {name: array[name] for name in array.dtype.names}
        elif array.ndim in (1, 2):
            self._columns = {str(index): column for index, column in enumerate(np.atleast_2d(array.T))}
        else:
            raise FileError(f"{file}: array of shape {array.shape}; (n,) or (n, columns) is wanted")
        self._file = file
        self.names = tuple(self._columns)
        if not array.size:
            raise FileError(f"{file}: there are no samples in it")

    def column(self, name: str) -> FloatArray:
        """Return a column, shape (n,), every value of it finite."""
        if name not in self._columns:
            raise FileError(f"{self._file}: no column {name!r}; there are: {', '.join(self.names)}")
        column = self._columns[name]
        if column.ndim != 1 or not np.can_cast(column.dtype, np.float64, "same_kind"):
            raise FileError(
                f"{self._file}, column {name!r}: {column.dtype} of shape {column.shape}; numbers are wanted"
            )
        values = np.ascontiguousarray(column, dtype=np.float64)
        faults = np.flatnonzero(~np.isfinite(values))
        if faults.size:
            row = int(faults[0])
            raise FileError(f"{self._file}, row {row}, column {name!r}: {values[row]} is not finite")
        return values


def _times(file: Path, source: _NpySource | Table, rate_hz: float | None, samples: int) -> npt.NDArray[np.int64]:
    column = next((name for name in TIME_COLUMNS if name in source.names), None)
    if rate_hz is not None and column is not None:
        raise SettingsError(f"{file}: column {column} tells the time; leave --rate away")
    if rate_hz is not None:
        t_us = np.arange(samples) * (1e6 / rate_hz)
    elif column is None:
        raise FileError(
            f"{file}: no column {', '.join(TIME_COLUMNS)} tells the time; give the sampling rate with --rate"
        )
    else:
        t_us = source.column(column) * TIME_COLUMNS[column]
    if np.abs(t_us).max() > 1e17:
        raise FileError(f"{file}: times up to {np.abs(t_us).max() / 1e6:g} s are beyond what can be counted in µs")
    return np.round(t_us).astype(np.int64)
