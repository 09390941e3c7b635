"""A recorded force in place of a scene: it is played back in time, wherever the tool is."""

from bisect import bisect_right
from pathlib import Path

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.errors import FileError
from hapticnet.recordings.loading import Columns, load_recording
from hapticnet.samples import LARGEST_COMPONENT, ForceSample, PositionSample, Vector


class RecordedScene:
    """A recorded force; satisfies `scene.base.Touchable`.

    It starts with the first position and passes as fast as it was recorded. Each position is answered with the last
    sample until then; after the end the force is zero.

    Parameters
    ----------
    t_us
        Times of the samples [µs], shape (n,), n ≥ 1, not decreasing.
    force_n
        Forces [N], shape (n, axes).
    """

    def __init__(self, t_us: IntArray, force_n: FloatArray, *, name: str) -> None:
        self.name = name
        self.axes: int = force_n.shape[1]
        self._times_us: list[int] = (t_us - t_us[0]).tolist()
        self._forces_n: list[Vector] = list(zip(*force_n.T.tolist(), strict=True))
        self._zero_n: Vector = (0.0,) * self.axes
        self._start_us: int | None = None

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force that was recorded at this time."""
        if self._start_us is None:
            self._start_us = sample.t_us
        since_us = sample.t_us - self._start_us
        after = bisect_right(self._times_us, since_us)
        if after == 0 or since_us > self._times_us[-1]:
            return ForceSample(sample.t_us, self._zero_n)
        return ForceSample(sample.t_us, self._forces_n[after - 1])


class RecordedForce:
    """A recorded force that several masters may feel, each from its beginning.

    Raise FileError if the file cannot be read or its force is out of range, SettingsError if more than three
    columns are chosen, and UnavailableError if the package that reads this kind of file is not installed.
    """

    def __init__(self, path: Path, *, columns: Columns | None = None) -> None:
        recording = load_recording(path, columns=columns)
        for row, axis in np.argwhere(~(np.abs(recording.force) <= LARGEST_COMPONENT))[:1].tolist():
            raise FileError(
                f"{path}: sample {row} is {recording.force[row, axis]} N; it must be within ±{LARGEST_COMPONENT:g} N"
            )
        self.name = f"recording:{path.name}"[:64]
        self.notes = recording.notes  # what the user should know about the file
        self._t_us = recording.t_us
        self._force_n = recording.force

    @property
    def axes(self) -> int:
        """Number of axes of the force."""
        return int(self._force_n.shape[1])

    @property
    def duration_us(self) -> int:
        """Time from the first sample to the last [µs]."""
        return int(self._t_us[-1] - self._t_us[0])

    def make(self) -> RecordedScene:
        """Return a scene that has not begun."""
        return RecordedScene(self._t_us, self._force_n, name=self.name)
