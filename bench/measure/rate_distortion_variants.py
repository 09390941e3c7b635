"""What published figures, payloads, settings and sampling rates change on the signals of rate_distortion.py."""

import itertools
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from hapticnet.codec.base import Codec
from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import codec_parameters, make_codec
from hapticnet.experiment.comparison import compare
from hapticnet.experiment.trial import Trial
from hapticnet.measure.bound import fewest_holds
from hapticnet.measure.quality import perceptual_distances
from hapticnet.node.offline import cost_report
from hapticnet.perception import WeberLaw

Row = dict[str, Any]

PUBLISHED: Final = {"deadband": 0.90, "velocity-adaptive": 0.96, "linear-predictive": 0.96, "least-squares": 0.96,
                    "passive-extrapolative": 0.89, "passive-interpolative": 0.89}  # fmt: skip
"""Largest packet-rate reductions reported by the papers that the codecs' docstrings name; the predictors share one."""

VARIANTS: Final[tuple[tuple[str, dict[str, float]], ...]] = (
    *(("linear-predictive", {"slope_samples": samples}) for samples in (3, 5, 8, 16)),
    *(("linear-predictive", {"horizon_ms": horizon_ms}) for horizon_ms in (50.0, 200.0)),
    *(("least-squares", {"updates": updates}) for updates in (2, 4)),
    *(("adaptive-predictive", {"window_ms": window_ms}) for window_ms in (10.0, 17.0, 30.0)),
    *(("adaptive-predictive", {"horizon_ms": horizon_ms}) for horizon_ms in (100.0, 400.0)),
)
"""Settings other than the defaults, to see how much they matter."""

DECIMATIONS: Final = (1, 2, 5, 10, 20)
"""One of this many samples is kept, to see what a lower sampling rate changes."""
RIVALS: Final = ("deadband", "adaptive-predictive", "linear-predictive", "least-squares")

JUMPS: Final = (0.0, 2.0, 1.0, 0.5)
"""Bounds on the jumps of our codec, in thresholds; 0: none."""

_fewest: dict[tuple[str, int, WeberLaw], int] = {}
"""The fewest holds by signal, number of samples and law: the same for all codecs."""


def averaged(trial: Trial, codec: Codec, beside: Sequence[float]) -> Row:
    """Return means over a threshold and those beside it: packets, packets over the optimum, and bytes."""
    found = []
    for factor in (1.0, *beside) if codec.name != "raw" else (1.0,):
        law = replace(codec.law, multiplier=factor * codec.law.multiplier)
        near = make_codec(codec.name, law, codec_parameters(codec))
        key = trial.name, len(trial.t_us), law
        if key not in _fewest:
            _fewest[key] = fewest_holds(law, trial.stimuli)
        encoding = encode_array(near, trial.t_us, trial.stimuli, trial.positions)
        cost = cost_report(near, trial.t_us, trial.stimuli, encoding)
        found.append((cost.sent, cost.sent / _fewest[key], cost.wire_bytes))
    sent, over_optimum, wire_bytes = map(statistics.fmean, zip(*found, strict=True))
    return {
        "near_sent": sent,
        "near_over_optimum": over_optimum,
        "near_wire_bytes": wire_bytes,
        "near_wire_bytes_per_s": wire_bytes / trial.seconds,
    }


def regimes(trials: Sequence[Trial], thresholds: Sequence[float]) -> list[Row]:
    """Return the reductions of published codecs over the threshold, on forces of the scale they were published for."""
    rows = []
    for trial in trials:
        law = WeberLaw()
        moves = perceptual_distances(law, trial.stimuli[1:], trial.stimuli[:-1])
        travelled_m = 0.0 if trial.positions is None else float(np.abs(np.diff(trial.positions, axis=0)).sum())
        for name, published in PUBLISHED.items():
            found = list(compare([trial], [make_codec(name, replace(law, multiplier=m)) for m in thresholds]))
            points = [
                {
                    "multiplier": row.multiplier,
                    "weber_fraction": row.multiplier * law.weber_fraction,
                    "reduction": row.cost.packet_rate_reduction,
                    "optimum_reduction": 1.0 - row.limits.holds / row.cost.samples,
                }
                for row in found
            ]
            rows.append(
                {
                    "trial": trial.name,
                    "peak_n": float(np.linalg.norm(trial.stimuli, axis=1).max()),
                    "samples_per_s": len(trial.t_us) / trial.seconds,
                    "jnds_per_s": 0.0 if moves is None else float(moves.sum()) / trial.seconds,
                    "mean_speed_m_per_s": travelled_m / trial.seconds,
                    "codec": name,
                    "published": published,
                    "points": points,
                    "reached_at": next((p["weber_fraction"] for p in points if p["reduction"] >= published), None),
                }
            )
    return rows


def payloads(trials: Sequence[Trial], thresholds: Iterable[float]) -> list[Row]:
    """Return what entropy coding saves of the wire bytes of float32 payloads: by fewer packets, and by payload."""
    rows = []
    for trial, multiplier in itertools.product(trials, thresholds):
        law = WeberLaw(multiplier=multiplier)
        found: dict[str, Row] = {}
        for key, codec in (
            ("float32", make_codec("linear-predictive", law)),
            ("coded", make_codec("least-squares", law)),
            ("ours", make_codec("adaptive-predictive", law, {"step_n": 0.001})),
        ):
            encoding = encode_array(codec, trial.t_us, trial.stimuli, trial.positions)
            cost = cost_report(codec, trial.t_us, trial.stimuli, encoding)
            payload = int(encoding.payload_bytes.sum(dtype=np.int64)) / max(cost.sent, 1)
            each = cost.wire_bytes / max(cost.sent, 1)
            found[key] = {"sent": cost.sent, "wire_bytes": cost.wire_bytes, "payload": payload, "each": each}
        base, coded = found["float32"], found["coded"]
        rows.append(
            {
                "trial": trial.name,
                "axes": trial.stimuli.shape[1],
                "multiplier": multiplier,
                "float32_bytes": base["payload"],
                "coded_bytes": coded["payload"],
                "headers_bytes": base["each"] - base["payload"],
                "saving": 1.0 - coded["wire_bytes"] / base["wire_bytes"],
                "ours_saving": 1.0 - found["ours"]["wire_bytes"] / base["wire_bytes"],
                "fewer_packets": 1.0 - coded["sent"] / base["sent"],
                "payload_saving": (base["payload"] - coded["payload"]) / base["each"],
                "largest_payload_saving": base["payload"] / base["each"],
            }
        )
    return rows


def steps(trials: Sequence[Trial], signal_of: Mapping[str, str]) -> list[Row]:
    """Return packets and jumps at 1 JND of the deadband, of linear prediction and of ours with each bound on jumps."""
    chosen = [
        make_codec("deadband", WeberLaw()),
        make_codec("linear-predictive", WeberLaw()),
        *(make_codec("adaptive-predictive", WeberLaw(), {"jump_thresholds": bound}) for bound in JUMPS),
    ]
    rows = []
    for codec in chosen:
        found = list(compare(trials, [codec]))
        rows.append(
            {
                "codec": codec.name,
                "bound": found[0].parameters.get("jump_thresholds"),
                "over_optimum": mean([(signal_of[row.trial], row.over_optimum) for row in found]),
                "jump_mean_jnd": mean([(signal_of[row.trial], row.quality.send_jump_mean_jnd) for row in found]),
                "jump_p999_jnd": max(row.quality.send_jump_p999_jnd for row in found),
                "jump_max_jnd": max(row.quality.send_jump_max_jnd for row in found),
            }
        )
    return rows


def settings(
    trials: Sequence[Trial],
    sets: Mapping[str, Sequence[str]],
    signal_of: Mapping[str, str],
    beside: Sequence[float],
    variants: Sequence[tuple[str, dict[str, float]]] = VARIANTS,
) -> list[Row]:
    """Return packets at 1 JND over the optimum with some settings, in the mean over each set of signals."""
    rows = []
    for name, parameters in variants:
        codec = make_codec(name, WeberLaw(), parameters)
        found = [(signal_of[trial.name], averaged(trial, codec, beside)["near_over_optimum"]) for trial in trials]
        means = {key: mean([each for each in found if each[0] in members]) for key, members in sets.items()}
        rows.append({"codec": name, "parameters": parameters, "over_optimum": means})
    return rows


def rates(
    trials: Sequence[Trial], sets: Mapping[str, Sequence[str]], signal_of: Mapping[str, str], beside: Sequence[float]
) -> list[Row]:
    """Return packets at 1 JND over the optimum on signals with samples left out."""
    rows = []
    for every in DECIMATIONS:
        fewer = [
            replace(
                trial,
                t_us=trial.t_us[::every],
                stimuli=trial.stimuli[::every],
                positions=None if trial.positions is None else trial.positions[::every],
            )
            for trial in trials
        ]
        found = settings(fewer, sets, signal_of, beside, [(name, {}) for name in RIVALS])
        rows += [{"every": every, **row} for row in found]
    return rows


def mean(figures: Iterable[tuple[str, float]]) -> float:
    """Return the mean over signals of figures, each given with its signal."""
    signals: dict[str, list[float]] = {}
    for signal, figure in figures:
        signals.setdefault(signal, []).append(figure)
    return statistics.fmean(map(statistics.fmean, signals.values()))
