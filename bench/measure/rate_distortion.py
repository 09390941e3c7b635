"""Every codec over every signal, threshold, payload and loss: its traffic, its error, and its distance from the best.

Also: which codec needs the fewest packets and bytes on each signal, and whether published reductions are reached.
"""

import argparse
import itertools
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any, Final

import numpy as np
import record
from codec_trials import force_codecs
from rate_distortion_signals import KINESTHETIC, made_signals, recorded_signals

from hapticnet.codec.base import Codec
from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import codec_parameters, make_codec
from hapticnet.experiment.comparison import REPAIR_US, compare
from hapticnet.experiment.comparison import Row as ComparisonRow
from hapticnet.experiment.trials import Trial, paper_trial
from hapticnet.measure.bound import fewest_holds
from hapticnet.node.offline import cost_report
from hapticnet.perception import WeberLaw

CODECS = force_codecs()

Row = dict[str, Any]

THRESHOLDS: Final = (0.5, 1.0, 2.0, 4.0)
LOSSES: Final = (0.05, 0.1, 0.3)
LOSS_SEEDS: Final = 3
"""How many lossy channels are tried, at 1 JND."""
NEAR: Final = (0.94, 0.97, 1.03, 1.06)
"""Factors of the thresholds beside each: the number of packets varies by a few per cent from one to the next."""
REGIME_THRESHOLDS: Final = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
KINESTHETIC_PEAK_N: Final = 10.0

KEPT: Final = (
    "trial", "codec", "multiplier", "samples", "sent", "over_optimum", "optimum_holds", "optimum_lines",
    "packet_rate_reduction", "packets_per_s", "wire_bytes", "wire_bytes_per_s", "session_wire_bytes_per_s",
    "exceed_jnd_fraction", "rmse_n",
    "max_error_n", "psnr_db", "hpw_psnr_db", "perceptual_mse", "send_jump_mean_jnd", "send_jump_max_jnd",
    "age_mean_us", "worst_100ms_packets", "energy_peak_j", "nanoseconds_per_sample", "loss",
)  # fmt: skip
MEANS: Final = (
    "near_sent", "near_over_optimum", "near_wire_bytes_per_s", "over_optimum", "over_lines", "packets_per_s",
    "wire_bytes_per_s", "session_wire_bytes_per_s", "packet_rate_reduction", "exceed_jnd_fraction", "rmse_n", "psnr_db",
    "hpw_psnr_db", "perceptual_mse", "send_jump_mean_jnd", "age_mean_us", "nanoseconds_per_sample",
    "optimum_holds_per_s", "optimum_lines_per_s",
)  # fmt: skip
LARGEST: Final = ("exceed_jnd_fraction", "max_error_n", "worst_100ms_packets", "energy_peak_j")

SETS: Final = {"paper's scene and recordings": ("scene", "recorded"), "made signals": ("made",)}
"""Sets of signals that are averaged over: name and kinds of signal. The first is what our codec was tuned on."""


PUBLISHED: Final = {"deadband": 0.90, "velocity-adaptive": 0.96, "linear-predictive": 0.96, "least-squares": 0.96,
                    "passive-extrapolative": 0.89, "passive-interpolative": 0.89}  # fmt: skip
"""Largest packet-rate reductions reported by the papers that the codecs' docstrings name; the predictors share one."""

_fewest: dict[tuple[str, int, WeberLaw], int] = {}
"""The fewest holds by signal, number of samples and law: the same for all codecs."""


def codecs(thresholds: Iterable[float]) -> list[Codec]:
    """Return every codec at every threshold; raw once."""
    made = [make_codec(name, WeberLaw(multiplier=each)) for each in thresholds for name in CODECS if name != "raw"]
    return [make_codec("raw", WeberLaw()), *made]


def lossless(
    trials: Sequence[Trial], kinds: Mapping[str, str], chosen: Sequence[Codec], beside: Sequence[float]
) -> list[Row]:
    """Return a row for every signal and codec without loss, packets and bytes also averaged over `beside`."""
    pairs = itertools.product(trials, chosen)
    return [
        kept(row) | averaged(trial, codec, beside) | {"kind": kinds[trial.name]}
        for row, (trial, codec) in zip(compare(trials, chosen), pairs, strict=True)
    ]


def lossy(trials: Sequence[Trial], losses: Sequence[float], seeds: Iterable[int]) -> list[Row]:
    """Return a row for every signal, codec, loss and seed of the losses, at 1 JND."""
    chosen = codecs((1.0,))
    return [kept(row) for seed in seeds for row in compare(trials, chosen, loss=losses, seed=seed)]


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


def kept(row: ComparisonRow) -> Row:
    """Return the recorded part of a row."""
    flat = row.flat()
    own = {
        "step_n": row.parameters.get("step_n", 0.0),
        "over_lines": row.cost.sent / row.limits.lines,
        "optimum_holds_per_s": row.packets_per_s / row.over_optimum,
        "optimum_lines_per_s": row.packets_per_s * row.limits.lines / row.cost.sent,
    }
    return {key: flat[key] for key in KEPT} | own


def averages(rows: Sequence[Row], sets: Mapping[str, Sequence[str]], signal_of: Mapping[str, str]) -> list[Row]:
    """Return means and largest values over each set of signals."""
    key = itemgetter("loss", "multiplier", "step_n", "codec")
    means = []
    for name, members in sets.items():
        inside: dict[tuple[float, float, float, str], list[Row]] = {}
        for row in rows:
            if signal_of[row["trial"]] in members:
                inside.setdefault(key(row), []).append(row)
        for (loss, multiplier, step_n, codec), block in inside.items():
            made = {"signals": name, "loss": loss, "multiplier": multiplier, "step_n": step_n, "codec": codec}
            for figure in MEANS:
                values = [(signal_of[row["trial"]], row.get(figure)) for row in block]
                # None: not measured, or infinite, like a jump where the law has no floor.
                made[figure] = None if any(value is None for _, value in values) else mean(values)
            for figure in LARGEST:
                made[f"largest_{figure}"] = max((row[figure] for row in block if row[figure] is not None), default=None)
            means.append(made)
    return means


def mean(figures: Iterable[tuple[str, float]]) -> float:
    """Return the mean over signals of figures, each given with its signal."""
    signals: dict[str, list[float]] = {}
    for signal, figure in figures:
        signals.setdefault(signal, []).append(figure)
    return statistics.fmean(map(statistics.fmean, signals.values()))


def contest(rows: Sequence[Row]) -> list[Row]:
    """Return the codecs with the fewest packets and the fewest bytes, on each signal at each threshold.

    Only codecs that keep to 1 JND on that signal, with a threshold of 1 JND, compete.
    """
    strict = {
        (row["trial"], row["codec"], row["step_n"])
        for row in rows
        if row["codec"] != "raw" and row["multiplier"] == 1.0 and row["exceed_jnd_fraction"] == 0.0
    }
    best = []
    for trial, multiplier in dict.fromkeys((row["trial"], row["multiplier"]) for row in rows if row["codec"] != "raw"):
        able = {
            (row["codec"], row["step_n"]): row
            for row in rows
            if (row["trial"], row["multiplier"]) == (trial, multiplier)
            and (trial, row["codec"], row["step_n"]) in strict
        }
        plain, ours = able["deadband", 0.0], able["adaptive-predictive", 0.0]
        entry: Row = {"trial": trial, "kind": plain["kind"], "multiplier": multiplier}
        for name, figure in (("packets", "near_sent"), ("bytes", "near_wire_bytes")):
            first = min(able.values(), key=itemgetter(figure))
            entry[name] = {
                "codec": first["codec"],
                "step_n": first["step_n"],
                "over_optimum": first["near_over_optimum"],
                "of_deadband": first[figure] / max(plain[figure], 1),
                "of_ours": first[figure] / max(ours[figure], 1),
            }
        entry["ours_of_deadband"] = ours["near_sent"] / max(plain["near_sent"], 1)
        best.append(entry)
    return best


def regimes(trials: Sequence[Trial], thresholds: Sequence[float]) -> list[Row]:
    """Return the reductions of published codecs over the threshold, on forces of the published scale."""
    rows = []
    for trial in trials:
        law = WeberLaw()
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
                    "codec": name,
                    "published": published,
                    "points": points,
                    "reached_at": next((p["weber_fraction"] for p in points if p["reduction"] >= published), None),
                }
            )
    return rows


def measure(arguments: argparse.Namespace) -> Row:
    """Return all results on the signals of each kind."""
    seed, quick = arguments.seed, arguments.quick
    if quick:
        arguments.seeds, arguments.seconds = 1, 1.0
    signals = {
        "scene": [paper_trial(each, insertions=1 if quick else 2) for each in range(seed, seed + arguments.seeds)],
        "recorded": recorded_signals(arguments.recordings),
        "made": made_signals(seed, arguments.seconds),
    }
    trials = [trial for members in signals.values() for trial in members]
    kinds = {trial.name: kind for kind, members in signals.items() for trial in members}
    # The paper's scene counts as one signal, whatever hand felt it.
    signal_of = {name: "paper's scene" if kind == "scene" else name for name, kind in kinds.items()}
    sets = {
        name: list(dict.fromkeys(signal_of[trial] for trial, kind in kinds.items() if kind in members))
        for name, members in SETS.items()
    }
    thresholds, losses = ((1.0,), (0.05,)) if quick else (THRESHOLDS, LOSSES)
    beside, seeds = ((), range(seed, seed + 1)) if quick else (NEAR, range(seed, seed + LOSS_SEEDS))
    rows = lossless(trials, kinds, codecs(thresholds), beside)
    singles = {name: [name] for name in signal_of.values()}
    peaks_n = {trial.name: float(np.linalg.norm(trial.stimuli, axis=1).max()) for trial in trials}
    strong = [trial for trial in trials if trial.name == KINESTHETIC or peaks_n[trial.name] >= KINESTHETIC_PEAK_N]
    return {
        "repair_us": REPAIR_US,
        "thresholds": thresholds,
        "beside": beside,
        "loss_seeds": len(seeds),
        "signals": [
            {
                "name": trial.name,
                "kind": kinds[trial.name],
                "samples": len(trial.t_us),
                "seconds": trial.seconds,
                "axes": trial.stimuli.shape[1],
                "peak_n": peaks_n[trial.name],
            }
            for trial in trials
        ],
        "sets": sets,
        "rows": rows,
        "averages": averages(rows + lossy(trials, losses, seeds), sets | singles, signal_of),
        "contest": contest(rows),
        "regimes": regimes(strong, (1.0, 4.0) if quick else REGIME_THRESHOLDS),
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument(
        "recordings", nargs="*", metavar="FILE[:FORCE[:POSITION[:SCALE]]]", help="recordings; SCALE in m per unit"
    )
    parser.add_argument("--seeds", type=record.within(1), default=3, help="how many orders of tissues and hands")
    parser.add_argument("--seconds", type=record.within(1.0, 1e4), default=15.0, help="length of each made signal")
    parser.add_argument("--quick", action="store_true", help="1 s, one scene, one threshold")
    unit = "as in each name; wire bytes with UDP and IPv4 headers, fractions and reductions 0 to 1"
    record.run(parser, measure, unit=unit)


if __name__ == "__main__":
    main()
