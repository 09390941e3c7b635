"""Error of the applied stimuli against the true ones, for whole recordings and as a running account."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import magnitude


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorReport:
    """Error of the applied stimuli against the true ones.

    Attributes
    ----------
    rmse_n
        Root of the mean squared norm of the difference [N].
    max_error_n
        Largest norm of the difference [N].
    exceed_jnd_fraction
        Fraction of samples at which a person could tell the two apart: ``|F - F̂| > max(k·|F̂|, floor)``. The
        reference is the applied stimulus F̂, which the skin feels. The codec's multiplier does not matter.
    """

    rmse_n: float
    max_error_n: float
    exceed_jnd_fraction: float


def error_report(law: WeberLaw, true: FloatArray, applied: FloatArray) -> ErrorReport:
    """Compare stimuli of shape (n, a); all errors are 0 if there are none."""
    if not len(true):
        return ErrorReport(rmse_n=0.0, max_error_n=0.0, exceed_jnd_fraction=0.0)
    error = norms(true - applied)
    jnd = law.jnds_n(norms(applied))
    return ErrorReport(
        rmse_n=float(np.sqrt(np.mean(error * error))),
        max_error_n=float(error.max()),
        exceed_jnd_fraction=float(np.mean(error > jnd)),
    )


class RunningError:
    """The same errors, computed sample by sample in constant memory."""

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
        if not error:  # nothing below changes then
            return
        self._squares += error * error
        if error > self._largest:
            self._largest = error
        if error > self._floor_n and error > self._weber_fraction * size:  # as `jnd_n`, without a call
            self._exceeded += 1

    @property
    def state(self) -> tuple[int, float, float, int]:
        """Samples, sum of the squared errors [N²], largest error [N], and samples with an error above a JND."""
        return self.samples, self._squares, self._largest, self._exceeded

    @state.setter
    def state(self, state: tuple[int, float, float, int]) -> None:
        self.samples, self._squares, self._largest, self._exceeded = state

    def report(self) -> ErrorReport:
        """Return the errors so far; all are 0 if nothing was added."""
        samples = max(self.samples, 1)
        return ErrorReport(
            rmse_n=math.sqrt(self._squares / samples),
            max_error_n=self._largest,
            exceed_jnd_fraction=self._exceeded / samples,
        )


def worst_window_packets(t_us: npt.NDArray[np.int64], window_us: int = 100_000) -> int:
    """Return the largest number of packets sent in any window [µs], which includes its start but not its end."""
    if not len(t_us):
        return 0
    ordered = np.sort(t_us)
    ends = np.searchsorted(ordered, ordered + window_us, side="left")
    return int(np.max(ends - np.arange(len(ordered))))


def norms(vectors: FloatArray) -> FloatArray:
    """Return the Euclidean norms of vectors of shape (n, a), shape (n,)."""
    roots: FloatArray = np.sqrt(np.sum(vectors * vectors, axis=1))
    return roots
