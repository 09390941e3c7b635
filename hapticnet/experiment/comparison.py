"""Codecs side by side: cost and error of each on a recording, and distance from the best possible."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.channel.settings import LONGEST_US, BernoulliLoss, ChannelSettings
from hapticnet.checks import check_parameter
from hapticnet.codec.base import Codec, Encoding
from hapticnet.codec.recording import encode_array, encode_lossy, encode_streamed
from hapticnet.codec.registry import codec_parameters
from hapticnet.errors import SettingsError
from hapticnet.experiment.trials import Trial
from hapticnet.experiment.workers import workers
from hapticnet.measure.bound import fewest_holds, fewest_lines
from hapticnet.measure.energy import energy_report
from hapticnet.measure.metrics import FeltReport, error_report
from hapticnet.measure.quality import QualityReport, quality_report
from hapticnet.node.closed_loop import Felt, simulate_link
from hapticnet.node.offline import CostReport, cost_report
from hapticnet.perception import WeberLaw
from hapticnet.scene.sources import make_scene

TIMED_SAMPLES: Final = 10_000
TIMED_PASSES: Final = 3  # passes over them; the fastest counts, because the others were disturbed
REPAIR_US: Final = 20_000  # time [µs] after which a lost update is replaced: a round trip across a city
DELAY_US: Final = 25_000  # delay of each way [µs] for the felt force: a link across a continent


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The fewest packets that any encoder needs (on several axes: lower bounds) under one law; see `measure.bound`."""

    holds: int  # with a zero-order hold
    lines: int  # with straight lines


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One codec with one law on one recording."""

    trial: str  # name of the recording
    codec: str
    label: str  # the codec with the parameters that differ from their defaults, as on a command line
    parameters: dict[str, float]
    at_rest: bool  # as if the tool were at rest: the codec needs positions, and none were given
    weber_fraction: float
    floor_n: float
    multiplier: float  # the codec's law; see `perception.WeberLaw`
    loss: float  # share of the updates that were lost at random
    delay_us: int  # delay of each way [µs] for `felt`
    cost: CostReport
    quality: QualityReport
    felt: FeltReport  # errors of the force applied at each tick against the true one, over such a link
    predicted: FeltReport | None  # the same if the slave answers for where the hand will be; None without a scene
    felt_created_share: float | None  # share of energy it creates (`measure.energy`); None without positions
    limits: Limits
    over_optimum: float  # packets sent over the fewest that any zero-order hold needs
    packets_per_s: float
    wire_bytes_per_s: float
    session_wire_bytes_per_s: float
    nanoseconds_per_sample: float
    """Time to encode and decode one sample in a stream, in plain Python on this machine [ns]. It is measured, so it
    varies from run to run, and grows when other processes are busy."""

    def flat(self) -> dict[str, Any]:
        """Return all figures in one level, for JSON and CSV. Infinite values become None: JSON has no infinity."""
        row = dataclasses.asdict(self)
        cost, quality, limits = (row.pop(part) for part in ("cost", "quality", "limits"))
        optimum = {f"optimum_{name}": packets for name, packets in limits.items()}
        unknown = dict.fromkeys(FeltReport.__dataclass_fields__)
        felt = {
            f"{kind}_{name}": value
            for kind in ("felt", "predicted")
            for name, value in (row.pop(kind) or unknown).items()
        }
        level = row | optimum | cost | quality | felt
        return {key: None if isinstance(value, float) and math.isinf(value) else value for key, value in level.items()}


def compare(
    trials: Sequence[Trial],
    codecs: Sequence[Codec],
    *,
    loss: float | Sequence[float] = 0.0,
    delay_us: int = DELAY_US,
    seed: int = 0,
    jobs: int = 1,
    on_row: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Run every codec, each with its own law, over every recording, in `jobs` processes; see `api.compare`.

    `on_row` gets each row as soon as it is complete, in order: the trial changes slowest, the codec fastest. Raise
    SettingsError if a number is out of range; SampleError if a codec refuses a sample; UnavailableError if a process
    ends.
    """
    losses = tuple(loss) if isinstance(loss, Sequence) else (loss,)
    for each in losses:
        check_parameter("loss", each, 0, 1)
    check_parameter("delay_us", delay_us, 0, LONGEST_US)
    laws = list(product(range(len(trials)), dict.fromkeys(codec.law for codec in codecs)))
    rows: list[Row] = []
    with workers(jobs, _Shared(trials, codecs, seed, delay_us)) as ordered_map:
        limits = dict(zip(laws, ordered_map(_limits, laws), strict=True))
        cases = product(range(len(trials)), losses, range(len(codecs)))
        for row in ordered_map(_row, [(*case, limits[case[0], codecs[case[2]].law]) for case in cases]):
            rows.append(row)
            if on_row is not None:
                on_row(row)
    return rows


class _Shared(NamedTuple):
    trials: Sequence[Trial]
    codecs: Sequence[Codec]
    seed: int
    delay_us: int


def encode_trial(
    codec: Codec, trial: Trial, *, loss: float = 0.0, seed: int = 0
) -> tuple[Encoding, npt.NDArray[np.int64]]:
    """Return a codec's result on a trial, and which of the sent updates arrive (indices, shape (m,))."""
    if not loss:
        encoding = encode_array(codec, trial.t_us, trial.stimuli, trial.positions)
        return encoding, encoding.sent
    rng = np.random.default_rng(seed)
    return encode_lossy(codec, trial.t_us, trial.stimuli, trial.positions, loss=loss, repair_us=REPAIR_US, rng=rng)


def felt_report(
    codec: Codec,
    trial: Trial,
    *,
    forward: ChannelSettings,
    feedback: ChannelSettings,
    repair_us: int,
    rng: np.random.Generator,
    predicted: bool = False,
) -> tuple[Felt, FeltReport, float | None]:
    """Return what is applied over a network, its errors, and the share of energy created; see `simulate_link`.

    `predicted`: whether the slave answers for where the hand will be. SettingsError if the trial has no scene.
    """
    if predicted and trial.scene is None:
        raise SettingsError(f"{trial.name}: there is no scene that can be copied, so the hand cannot be predicted")
    felt = simulate_link(
        codec,
        trial.t_us,
        trial.stimuli,
        trial.positions,
        forward=forward,
        feedback=feedback,
        repair_us=repair_us,
        rng=rng,
        scene=make_scene(trial.scene) if predicted and trial.scene else None,
    )
    errors = error_report(codec.law, trial.stimuli, felt.applied)
    if trial.positions is None:
        return felt, errors, None
    return felt, errors, energy_report(codec.law, trial.stimuli, felt.applied, trial.positions).created_share


def delayed_report(
    codec: Codec,
    trial: Trial,
    *,
    loss: float = 0.0,
    delay_us: int = DELAY_US,
    seed: int = 0,
    predicted: bool = False,
) -> tuple[FeltReport, float | None]:
    """Return the same over a link that delays both ways and loses updates; they are replaced after a round trip."""
    forward = ChannelSettings(delay_us=delay_us)
    feedback = ChannelSettings(delay_us=delay_us, loss=BernoulliLoss(loss) if loss else None)
    repair_us, rng = REPAIR_US + 2 * delay_us, np.random.default_rng(seed)
    return felt_report(
        codec, trial, forward=forward, feedback=feedback, repair_us=repair_us, rng=rng, predicted=predicted
    )[1:]


def codec_label(codec: Codec) -> str:
    """Return a codec as written on a command line, with the parameters that differ from their defaults."""
    usual = {field.name: field.default for field in dataclasses.fields(codec)}
    changed = [f"{key}={value:g}" for key, value in codec_parameters(codec).items() if value != usual[key]]
    return f"{codec.name}:{','.join(changed)}" if changed else codec.name


def _limits(shared: _Shared, case: tuple[int, WeberLaw]) -> Limits:
    trial, law = shared.trials[case[0]], case[1]
    return Limits(holds=fewest_holds(law, trial.stimuli), lines=fewest_lines(law, trial.t_us, trial.stimuli))


def _row(shared: _Shared, case: tuple[int, float, int, Limits]) -> Row:
    trial, loss, codec, limits = shared.trials[case[0]], case[1], shared.codecs[case[2]], case[3]
    encoding, received = encode_trial(codec, trial, loss=loss, seed=shared.seed)
    cost = cost_report(codec, trial.t_us, trial.stimuli, encoding)
    quality = quality_report(
        codec.law, trial.t_us, trial.stimuli, encoding.decoded, encoding.sent, trial.positions, received=received
    )
    link = partial(delayed_report, codec, trial, loss=loss, delay_us=shared.delay_us, seed=shared.seed)
    felt, created_share = link()
    predicted = None if trial.scene is None else link(predicted=True)[0]
    return Row(
        trial=trial.name,
        codec=codec.name,
        label=codec_label(codec),
        parameters=codec_parameters(codec),
        at_rest=codec.needs_position and trial.positions is None,
        weber_fraction=codec.law.weber_fraction,
        floor_n=codec.law.floor_n,
        multiplier=codec.law.multiplier,
        loss=loss,
        delay_us=shared.delay_us,
        cost=cost,
        quality=quality,
        felt=felt,
        predicted=predicted,
        felt_created_share=created_share,
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
