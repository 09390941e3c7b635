"""Error of the applied stimuli against the true ones, for whole recordings."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.perception import WeberLaw

FELT_JNDS: Final = (2, 4, 8)  # JNDs above which ticks are counted besides 1


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


@dataclass(frozen=True, slots=True, kw_only=True)
class FeltReport(ErrorReport):
    """The same, and how large the errors are: over a network most samples are above one JND, whatever the codec.

    Attributes
    ----------
    above_2_jnd_fraction, above_4_jnd_fraction, above_8_jnd_fraction
        Fractions of samples whose error is more than so many JNDs, ``n·max(k·|F̂|, floor)``.
    p99_error_n
        99th percentile of the norm of the difference [N].
    """

    above_2_jnd_fraction: float
    above_4_jnd_fraction: float
    above_8_jnd_fraction: float
    p99_error_n: float


def error_report(law: WeberLaw, true: FloatArray, applied: FloatArray) -> FeltReport:
    """Compare stimuli of shape (n, a); all errors are 0 if there are none."""
    error = norms(true - applied) if len(true) else np.zeros(1)
    jnd = law.jnds_n(norms(applied)) if len(true) else np.ones(1)
    return FeltReport(
        rmse_n=float(np.sqrt(np.mean(error * error))),
        max_error_n=float(error.max()),
        exceed_jnd_fraction=float(np.mean(error > jnd)),
        **{f"above_{jnds}_jnd_fraction": float(np.mean(error > jnds * jnd)) for jnds in FELT_JNDS},
        p99_error_n=float(np.percentile(error, 99.0, method="inverted_cdf")),
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
