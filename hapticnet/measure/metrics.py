"""Error of the applied stimuli against the true ones, for whole recordings."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.perception import WeberLaw


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
