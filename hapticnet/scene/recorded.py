"""A recorded force instead of a scene, played back in time at any position of the tool."""

from bisect import bisect_right

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.samples import ForceSample, PositionSample, Vector


class RecordedScene:
    """A recorded force; satisfies `scene.base.Touchable`.

    It starts with the first position and plays at the recorded speed. Each position is answered with the last
    sample until then; after the end the force is zero. Times [µs] have the shape (n,), n ≥ 1, and do not decrease;
    forces [N] have the shape (n, axes).
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
