"""Error of the applied stimuli against the true ones, sample by sample. `measure.metrics` is for recordings."""

import math

from hapticnet.measure.metrics import ErrorReport
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import magnitude


class RunningError:
    """Running errors in constant memory."""

    __slots__ = ("_exceeded", "_floor_n", "_largest", "_squares", "_weber_fraction", "samples")

    def __init__(self, law: WeberLaw) -> None:
        self._weber_fraction, self._floor_n = law.weber_fraction, law.floor_n
        self.samples = 0
        self._squares = 0.0
        self._largest = 0.0
        self._exceeded = 0

    def add(self, true: Vector, applied: Vector) -> None:
        """Add one sample."""
        self.samples += 1
        if len(true) == 1:
            error, size = abs(true[0] - applied[0]), abs(applied[0])
        else:
            error, size = magnitude(tuple(x - y for x, y in zip(true, applied, strict=True))), magnitude(applied)
        if not error:  # the rest does not change then
            return
        self._squares += error * error
        if error > self._largest:
            self._largest = error
        if error > self._floor_n and error > self._weber_fraction * size:  # `jnd_n` inlined
            self._exceeded += 1

    def report(self) -> ErrorReport:
        """Return the errors so far; all are 0 if nothing was added."""
        samples = max(self.samples, 1)
        return ErrorReport(
            rmse_n=math.sqrt(self._squares / samples),
            max_error_n=self._largest,
            exceed_jnd_fraction=self._exceeded / samples,
        )
