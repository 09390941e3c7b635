"""A recording on which codecs are compared."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.errors import SampleError
from hapticnet.samples import LARGEST_COMPONENT


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A recording on which codecs are compared.

    Attributes
    ----------
    name
        Name in tables and figures.
    t_us, stimuli
        Time stamps [µs], shape (n,), and stimuli [N], shape (n, a).
    positions
        Positions of the tool [m], shape (n, a), if known.

    Raises
    ------
    SampleError
        If a stimulus or a position is not finite or is out of range.
    """

    name: str
    t_us: npt.NDArray[np.int64]
    stimuli: FloatArray
    positions: FloatArray | None = None

    def __post_init__(self) -> None:
        for what, values in (("stimulus", self.stimuli), ("position", self.positions)):
            if values is None:
                continue
            good = (np.abs(values) <= LARGEST_COMPONENT).all(axis=1)
            if not good.all():
                first = int(np.argmin(good))
                raise SampleError(
                    f"{self.name}, sample {first}: {what} {values[first].tolist()} is not finite and within"
                    f" ±{LARGEST_COMPONENT:g}"
                )

    @property
    def seconds(self) -> float:
        """Duration [s], including the last sample period."""
        samples = len(self.t_us)
        span_s = float(self.t_us[-1] - self.t_us[0]) * 1e-6
        return span_s * samples / (samples - 1) if samples > 1 else 1.0

    def account(self) -> dict[str, Any]:
        """Describe the recording itself, for JSON."""
        gaps_us = np.diff(self.t_us)
        return {
            "name": self.name,
            "samples": len(self.t_us),
            "axes": self.stimuli.shape[1],
            "seconds": self.seconds,
            "period_ms": float(np.median(gaps_us)) / 1e3 if len(gaps_us) else 0.0,
            "longest_gap_ms": float(gaps_us.max(initial=0)) / 1e3,
            "peak_n": float(np.linalg.norm(self.stimuli, axis=1).max(initial=0.0)),
            "mean_speed_m_per_s": None
            if self.positions is None
            else float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum()) / self.seconds,
        }
