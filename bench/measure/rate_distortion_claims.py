"""What papers report and what was aimed at, tried on rate_distortion.py's signals: reductions, payloads, steps."""

import itertools
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from hapticnet.codec.registry import make_codec
from hapticnet.experiment.comparison import Trial, compare
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
"""Settings beside the usual ones: how much of a lead is in the tuning."""

DECIMATIONS: Final = (1, 2, 5, 10, 20)
RIVALS: Final = ("deadband", "adaptive-predictive", "linear-predictive", "least-squares")
"""How many samples are skipped to see what a slower sampling does, and to which codecs."""

JUMPS: Final = (0.0, 2.0, 1.0, 0.5)
"""Bounds on the jumps of our codec, in thresholds; 0: none."""


def regimes(trials: Sequence[Trial], thresholds: Sequence[float]) -> list[Row]:
    """Return what the published codecs reach over the threshold on forces of the scale they were published for."""
    rows = []
    for trial in trials:
        law = WeberLaw()
        moves = perceptual_distances(law, trial.stimuli[1:], trial.stimuli[:-1])
        moved = 0.0 if moves is None else float(moves.sum())
        speed = (
            0.0
            if trial.positions is None
            else float(np.abs(np.diff(trial.positions, axis=0)).sum()) / max(trial.seconds, 1e-9)
        )
        for name, published in PUBLISHED.items():
            found = list(compare([trial], [make_codec(name, replace(law, multiplier=m)) for m in thresholds]))
            points = [
                {
                    "multiplier": row.multiplier,
                    "weber_fraction": row.multiplier * law.weber_fraction,
                    "reduction": row.cost.packet_rate_reduction,
                    "exceed_jnd_fraction": row.quality.exceed_jnd_fraction,
                    "optimum_reduction": 1.0 - row.limits.holds / row.cost.samples,
                }
                for row in found
            ]
            rows.append(
                {
                    "trial": trial.name,
                    "peak_n": float(np.linalg.norm(trial.stimuli, axis=1).max()),
                    "samples_per_s": len(trial.t_us) / trial.seconds,
                    "jnds_per_s": moved / trial.seconds,
                    "mean_speed_m_per_s": speed,
                    "has_position": trial.positions is not None,
                    "codec": name,
                    "published": published,
                    "points": points,
                    "reached_at": next((p["weber_fraction"] for p in points if p["reduction"] >= published), None),
                }
            )
    return rows


def payloads(trials: Sequence[Trial], thresholds: Iterable[float]) -> list[Row]:
    """Return wire bytes of the entropy-coded predictor beside the float32 one: from fewer packets, and from payload."""
    rows = []
    for trial, multiplier in itertools.product(trials, thresholds):
        law = WeberLaw(multiplier=multiplier)
        row: Row = {"trial": trial.name, "multiplier": multiplier}
        for key, codec in (
            ("float32", make_codec("linear-predictive", law)),
            ("coded", make_codec("least-squares", law)),
            ("ours", make_codec("adaptive-predictive", law, {"step_n": 0.001})),
        ):
            encoding = codec.encode_array(trial.t_us, trial.stimuli, trial.positions)
            cost = cost_report(codec, trial.t_us, trial.stimuli, encoding)
            payload = int(encoding.payload_bytes.sum(dtype=np.int64))
            sent = max(cost.sent, 1)
            row[key] = {
                "sent": cost.sent,
                "wire_bytes": cost.wire_bytes,
                "payload_per_packet": payload / sent,
                "headers_per_packet": (cost.wire_bytes - payload) / sent,
                "exceed_jnd_fraction": cost.exceed_jnd_fraction,
            }
        base, coded = row["float32"], row["coded"]
        each = base["payload_per_packet"] + base["headers_per_packet"]
        row["saving"] = 1.0 - coded["wire_bytes"] / base["wire_bytes"]
        row["ours_saving"] = 1.0 - row["ours"]["wire_bytes"] / base["wire_bytes"]
        row["fewer_packets"] = 1.0 - coded["sent"] / base["sent"]
        row["payload_saving"] = (base["payload_per_packet"] - coded["payload_per_packet"]) / each
        row["largest_payload_saving"] = base["payload_per_packet"] / each
        rows.append(row)
    return rows


def steps(trials: Sequence[Trial], kinds: Mapping[str, str]) -> list[Row]:
    """Return packets and jumps at 1 JND of the deadband, of linear prediction and of ours with each bound on jumps.

    Means over the signals, the paper's scene being one, and the largest over all.
    """
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
                "over_optimum": mean([(kinds[row.trial], row.trial, row.over_optimum) for row in found]),
                "jump_mean_jnd": mean([(kinds[row.trial], row.trial, row.quality.send_jump_mean_jnd) for row in found]),
                "jump_p999_jnd": max(row.quality.send_jump_p999_jnd for row in found),
                "jump_max_jnd": max(row.quality.send_jump_max_jnd for row in found),
            }
        )
    return rows


def settings(
    trials: Sequence[Trial],
    kinds: Mapping[str, str],
    beside: Sequence[float],
    variants: Sequence[tuple[str, dict[str, float]]],
) -> list[Row]:
    """Return packets at 1 JND over the optimum with some settings, averaged over thresholds beside."""
    laws = [WeberLaw(multiplier=factor) for factor in (1.0, *beside)]
    fewest = {(trial.name, law): fewest_holds(law, trial.stimuli) for trial in trials for law in laws}
    rows = []
    for name, parameters in variants:
        figures = []
        for trial in trials:
            sent = [
                len(make_codec(name, law, parameters).encode_array(trial.t_us, trial.stimuli, trial.positions).sent)
                / fewest[trial.name, law]
                for law in laws
            ]
            figures.append((kinds[trial.name], trial.name, statistics.fmean(sent)))
        row: Row = {"codec": name, "parameters": parameters}
        for which, members in (("aimed_at", ("scene", "recorded")), ("made", ("made",))):
            row[which] = mean([figure for figure in figures if figure[0] in members])
        rows.append(row)
    return rows


def rates(trials: Sequence[Trial], kinds: Mapping[str, str], beside: Sequence[float]) -> list[Row]:
    """Return packets at 1 JND over the optimum on signals of which every so many samples are left."""
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
        for row in settings(fewer, kinds, beside, variants=[(name, {}) for name in RIVALS]):
            rows.append({"every": every, **row})
    return rows


def mean(figures: Iterable[tuple[str, str, float]]) -> float:
    """Return the mean of figures, each with its signal's kind and name: the paper's scene counts as one signal."""
    groups: dict[str, list[float]] = {}
    for kind, trial, figure in figures:
        groups.setdefault("scene" if kind == "scene" else trial, []).append(figure)
    return statistics.fmean(map(statistics.fmean, groups.values()))
