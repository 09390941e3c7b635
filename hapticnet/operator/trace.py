"""Playback of a recorded motion."""

from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapticnet.errors import FileError, SampleError, SettingsError
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, PositionSample, Vector
from hapticnet.tables import Numbers, read_csv

LARGEST_TIME_S: Final = 1e12
"""Largest time stamp. Seconds since 1970 fit; milliseconds and microseconds since then do not, and are refused."""


class TraceOperator:
    """A recorded motion, interpolated linearly between its samples.

    Parameters
    ----------
    t_s
        Times of the samples [s], rising by 1 µs or more; the first one is where playback starts.
    position_m
        Positions [m], shape (samples, axes).
    loop
        Whether the trace starts again after its last sample, and jumps to its first position there. Otherwise the
        first and the last position are held before and after.

    Attributes
    ----------
    axes
        Number of axes of a position.
    duration_us
        Time from the first sample to the last [µs]; None for a loop.

    Raises
    ------
    SampleError
        When there are fewer than two samples, a value is not finite or out of range, or time does not rise.
    """

    __slots__ = ("_period_us", "_positions_m", "_times_us", "axes", "duration_us")

    def __init__(self, t_s: Numbers, position_m: Numbers, *, loop: bool = False) -> None:
        if position_m.ndim != 2 or not 1 <= position_m.shape[1] <= MAX_AXES or t_s.shape != position_m.shape[:1]:
            raise SampleError(
                f"trace has times of shape {t_s.shape} and positions of shape {position_m.shape}; "
                f"(samples,) and (samples, 1 to {MAX_AXES}) are wanted"
            )
        fault = _first_fault(t_s, position_m)
        if fault is not None:
            raise SampleError(f"trace sample {fault.row}: {fault.reason}")
        self.axes: int = position_m.shape[1]
        self._times_us: list[int] = _whole_us(t_s).tolist()
        self._positions_m: list[Vector] = list(zip(*position_m.T.tolist(), strict=True))
        self._period_us = self._times_us[-1] if loop else None
        self.duration_us = None if loop else self._times_us[-1]

    def sample(self, t_us: int) -> PositionSample:
        """Return the position at `t_us` [µs] since the start of the trace."""
        at_us = t_us if self._period_us is None else t_us % self._period_us
        times_us = self._times_us
        after = bisect_right(times_us, at_us)
        if after == 0:
            return PositionSample(t_us, self._positions_m[0])
        if after == len(times_us):
            return PositionSample(t_us, self._positions_m[-1])
        from_us = times_us[after - 1]
        share = (at_us - from_us) / (times_us[after] - from_us)
        from_m, to_m = self._positions_m[after - 1], self._positions_m[after]
        return PositionSample(t_us, tuple([a + (b - a) * share for a, b in zip(from_m, to_m, strict=True)]))


def load_trace(
    path: Path,
    *,
    time_column: str = "t_s",
    position_columns: Sequence[str] = ("position_m",),
    loop: bool = False,
) -> TraceOperator:
    """Return the motion recorded in a CSV file.

    Parameters
    ----------
    path
        The file.
    time_column
        Name or number of the column with the times [s].
    position_columns
        Names or numbers of the columns with the positions [m], one an axis.
    loop
        Whether it is played again and again.

    Raises
    ------
    FileError
        When the file cannot be read or a value in it cannot be used; names line and column.
    SettingsError
        When there are no position columns or more than three.
    """
    if not 1 <= len(position_columns) <= MAX_AXES:
        raise SettingsError(f"{len(position_columns)} position columns are given; 1 to {MAX_AXES} are wanted")
    table = read_csv(path)
    t_s = table.column(time_column)
    position_m = np.column_stack([table.column(name) for name in position_columns])
    fault = _first_fault(t_s, position_m)
    if fault is not None:
        column = (time_column, *position_columns)[fault.column]
        raise FileError(f'{path}, line {table.line_of(fault.row)}, column "{column}": {fault.reason}')
    return TraceOperator(t_s, position_m, loop=loop)


class _Fault(NamedTuple):
    """What is wrong first with a trace: column 0 is the time, the others are the axes from 1."""

    row: int
    column: int
    reason: str


def _first_fault(t_s: Numbers, position_m: Numbers) -> _Fault | None:
    if len(t_s) < 2:
        return _Fault(0, 0, "a trace of one sample or none; two or more are wanted")
    # Written so that NaN, which compares false with everything, is a fault too.
    for row in np.flatnonzero(~(np.abs(t_s) <= LARGEST_TIME_S))[:1].tolist():
        return _Fault(row, 0, f"time is {t_s[row]} s; it must be within ±{LARGEST_TIME_S:g} s")
    for row in np.flatnonzero(np.diff(_whole_us(t_s)) < 1)[:1].tolist():
        reason = f"time {t_s[row + 1]} s does not follow on {t_s[row]} s; it must rise by 1 us or more each row"
        return _Fault(row + 1, 0, reason)
    for row, axis in np.argwhere(~(np.abs(position_m) <= LARGEST_COMPONENT))[:1].tolist():
        reason = f"position is {position_m[row, axis]} m; it must be within ±{LARGEST_COMPONENT:g} m"
        return _Fault(row, axis + 1, reason)
    return None


def _whole_us(t_s: Numbers) -> NDArray[np.int64]:
    """Return times [µs] since the first one."""
    times_us: NDArray[np.int64] = np.rint((t_s - t_s[0]) * 1e6).astype(np.int64)
    return times_us
