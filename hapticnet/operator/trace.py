"""Playback of a recorded motion."""

from bisect import bisect_right
from pathlib import Path

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.errors import FileError, SampleError
from hapticnet.recordings.loading import Columns, load_motion
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, PositionSample, Vector


class TraceOperator:
    """A recorded motion, interpolated linearly between its samples.

    Times [µs] have the shape (n,) with n ≥ 2 and increase; playback starts at the first one. Positions [m] have the
    shape (n, axes). A `loop` jumps from the last to the first position; otherwise the last position is held. Raise
    SampleError if there are fewer than two samples, a position is not finite or out of range, or time does not
    increase.
    """

    __slots__ = ("_period_us", "_positions_m", "_times_us", "axes", "duration_us")

    def __init__(self, t_us: IntArray, position_m: FloatArray, *, loop: bool = False) -> None:
        if position_m.ndim != 2 or not 1 <= position_m.shape[1] <= MAX_AXES or t_us.shape != position_m.shape[:1]:
            raise SampleError(
                f"trace has times of shape {t_us.shape} and positions of shape {position_m.shape}; "
                f"expected (samples,) and (samples, 1 to {MAX_AXES})"
            )
        if len(t_us) < 2:
            raise SampleError(f"trace has {len(t_us)} samples; it must have two or more")
        for row in np.flatnonzero(np.diff(t_us) < 1)[:1].tolist():
            raise SampleError(
                f"trace sample {row + 1}: time {t_us[row + 1]} us follows {t_us[row]} us; expected 1 us later or more"
            )
        # NaN compares false with everything, so this form rejects it too.
        for row, axis in np.argwhere(~(np.abs(position_m) <= LARGEST_COMPONENT))[:1].tolist():
            raise SampleError(
                f"trace sample {row}: position is {position_m[row, axis]} m; it must be within ±{LARGEST_COMPONENT:g} m"
            )
        self.axes: int = position_m.shape[1]
        self._times_us: list[int] = (t_us - t_us[0]).tolist()
        self._positions_m: list[Vector] = list(zip(*position_m.T.tolist(), strict=True))
        self._period_us = self._times_us[-1] if loop else None
        # Time from the first sample to the last [µs]; None for a loop
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
    path: Path, *, position: Columns | None = None, loop: bool = False
) -> tuple[TraceOperator, tuple[str, ...]]:
    """Return the motion in a file that `load_motion` reads, such as a recording of hapticnet, and notes for the user.

    `position` names one to three columns; None: those called position, or the only column that is not time. Raise
    FileError if the file cannot be read or its motion cannot be played, SettingsError if more than three columns are
    chosen, and UnavailableError if the package that reads this kind of file is not installed.
    """
    motion = load_motion(path, position=position)
    try:
        return TraceOperator(motion.t_us, motion.position, loop=loop), motion.notes
    except SampleError as error:
        raise FileError(f"{path}: {error}") from error
