"""Codecs side by side: what each costs and does on a recording, and how far from the best possible that is."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.codec.base import Codec
from hapticnet.codec.recording import encode_lossy, encode_streamed
from hapticnet.codec.registry import CODECS, codec_parameters
from hapticnet.errors import SampleError
from hapticnet.measure.bound import fewest_holds, fewest_lines
from hapticnet.measure.quality import QualityReport, quality_report
from hapticnet.node.offline import CostReport, cost_report
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT

TIMED_SAMPLES: Final = 10_000
TIMED_PASSES: Final = 3
"""Samples over which a streaming pair is timed, and how often: the best counts, the others met a busy machine."""

REPAIR_US: Final = 20_000
"""After this time [µs] a lost update is replaced by the present one: about a round trip over a city, and its spread."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A recording on which codecs are compared.

    Attributes
    ----------
    name
        What it is called.
    t_us, stimuli
        Time stamps [µs], shape (n,), and stimuli [N], shape (n, a).
    positions
        Positions of the tool [m], shape (n, a), where they are known.

    Raises
    ------
    SampleError
        When a stimulus or a position is not finite or out of range.
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
        """How long it is [s], its last sample period included."""
        samples = len(self.t_us)
        span_s = float(self.t_us[-1] - self.t_us[0]) * 1e-6
        return span_s * samples / (samples - 1) if samples > 1 else 1.0

    def account(self) -> dict[str, Any]:
        """Return what there is to know of the recording before any codec, for JSON."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The fewest packets any encoder could do with on one recording under one law; see `measure.bound`.

    Attributes
    ----------
    holds, lines
        With a zero-order hold, and with straight lines. For two and three axes numbers that cannot be undercut.
    """

    holds: int
    lines: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One codec under one law on one recording.

    Attributes
    ----------
    over_optimum
        Packets sent over the fewest that any zero-order hold could do with.
    nanoseconds_per_sample
        Time for encoding and decoding one sample in a stream, in plain Python on this machine [ns].
    """

    trial: str
    codec: str
    parameters: dict[str, float]
    multiplier: float
    cost: CostReport
    quality: QualityReport
    limits: Limits
    over_optimum: float
    packets_per_s: float
    wire_bytes_per_s: float
    session_wire_bytes_per_s: float
    nanoseconds_per_sample: float

    @property
    def label(self) -> str:
        """The codec as it is written on a command line: with the parameters that are not its own defaults."""
        usual = codec_parameters(CODECS[self.codec]())
        changed = [f"{key}={value:g}" for key, value in self.parameters.items() if value != usual[key]]
        return f"{self.codec}:{','.join(changed)}" if changed else self.codec

    @property
    def at_rest(self) -> bool:
        """Whether the codec's rule depends on motion and none was known, so that it did as at rest."""
        return CODECS[self.codec].needs_position and self.quality.energy_peak_j is None

    def flat(self) -> dict[str, Any]:
        """Return all of it in one level, for JSON, which knows no infinity: what is infinite is None there."""
        row = asdict(self)
        cost, quality, limits = row.pop("cost"), row.pop("quality"), row.pop("limits")
        level = {
            **row,
            "label": self.label,
            "at_rest": self.at_rest,
            "optimum_holds": limits["holds"],
            "optimum_lines": limits["lines"],
            **cost,
            **quality,
        }
        return {key: None if isinstance(value, float) and math.isinf(value) else value for key, value in level.items()}


def compare(trials: Sequence[Trial], codecs: Sequence[Codec], *, loss: float = 0.0, seed: int = 0) -> Iterator[Row]:
    """Yield a row for every codec (each with its own law) on every trial, trial by trial.

    Parameters
    ----------
    loss
        Share of updates that get lost, each at random; each is replaced after `REPAIR_US`.
    seed
        Of the losses; the same for all codecs.
    """
    for trial in trials:
        limits: dict[WeberLaw, Limits] = {}
        for codec in codecs:
            if codec.law not in limits:
                limits[codec.law] = find_limits(codec.law, trial)
            yield _row(trial, codec, limits[codec.law], loss, seed)


def find_limits(law: WeberLaw, trial: Trial) -> Limits:
    """Return the fewest packets for a trial."""
    return Limits(
        holds=fewest_holds(law, trial.stimuli),
        lines=fewest_lines(law, trial.t_us, trial.stimuli),
    )


def _row(trial: Trial, codec: Codec, limits: Limits, loss: float, seed: int) -> Row:
    received = None
    if loss:
        encoding, received = encode_lossy(
            codec,
            trial.t_us,
            trial.stimuli,
            trial.positions,
            loss=loss,
            repair_us=REPAIR_US,
            rng=np.random.default_rng(seed),
        )
    else:
        encoding = codec.encode_array(trial.t_us, trial.stimuli, trial.positions)
    cost = cost_report(codec, trial.t_us, trial.stimuli, encoding)
    quality = quality_report(
        codec.law, trial.t_us, trial.stimuli, encoding.decoded, encoding.sent, trial.positions, received=received
    )
    return Row(
        trial=trial.name,
        codec=codec.name,
        parameters=codec_parameters(codec),
        multiplier=codec.law.multiplier,
        cost=cost,
        quality=quality,
        limits=limits,
        over_optimum=cost.sent / limits.holds if limits.holds else 1.0,
        packets_per_s=cost.sent / trial.seconds,
        wire_bytes_per_s=cost.wire_bytes / trial.seconds,
        session_wire_bytes_per_s=cost.session_wire_bytes / trial.seconds,
        nanoseconds_per_sample=_nanoseconds_per_sample(codec, trial),
    )


def _nanoseconds_per_sample(codec: Codec, trial: Trial) -> float:
    some = slice(0, TIMED_SAMPLES)
    positions = None if trial.positions is None else trial.positions[some]
    best_s = math.inf
    for _ in range(TIMED_PASSES):
        started_s = time.perf_counter()
        encode_streamed(codec, trial.t_us[some], trial.stimuli[some], positions)
        best_s = min(best_s, time.perf_counter() - started_s)
    return best_s / max(len(trial.t_us[some]), 1) * 1e9
