"""Every codec over every signal, threshold, payload and loss: what it sends, what error that costs, how far from best.

Beside the table: who does with the fewest packets and bytes on each signal, whether the reductions that are published
are reached on a force of that scale, and what entropy coding of the payload can save under the headers of a packet.
"""

import argparse
import itertools
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
import record
from rate_distortion_signals import KINESTHETIC, made_signals, paper_signals, recorded_signal

from hapticnet.codec.base import Codec
from hapticnet.codec.quality import perceptual_distances
from hapticnet.codec.registry import CODECS, codec_parameters, make_codec
from hapticnet.errors import HapticnetError
from hapticnet.experiment.comparison import REPAIR_US, Trial, compare
from hapticnet.node.offline import cost_report
from hapticnet.perception import WeberLaw

Row = dict[str, Any]

THRESHOLDS: Final = (0.5, 1.0, 2.0, 4.0)
STEPS_N: Final = (0.0, 0.001)
LOSSES: Final = (0.0, 0.05, 0.3)
REGIME_THRESHOLDS: Final = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
KINESTHETIC_PEAK_N: Final = 10.0

PUBLISHED: Final = {"deadband": 0.90, "velocity-adaptive": 0.96, "linear-predictive": 0.96, "least-squares": 0.96,
                    "passive-extrapolative": 0.89, "passive-interpolative": 0.89}  # fmt: skip
"""Largest packet-rate reductions reported; sources: the codecs' docstrings. Those of the predictors is one figure."""

KEPT: Final = (
    "trial", "codec", "multiplier", "samples", "sent", "over_optimum", "optimum_holds", "optimum_lines",
    "packet_rate_reduction", "packets_per_s", "wire_bytes", "wire_bytes_per_s", "exceed_jnd_fraction", "rmse_n",
    "max_error_n", "perceptual_mse", "send_jump_mean_jnd", "send_jump_max_jnd", "age_mean_us", "worst_100ms_packets",
    "energy_peak_j", "nanoseconds_per_sample",
)  # fmt: skip
MEANS: Final = (
    "over_optimum", "packets_per_s", "wire_bytes_per_s", "packet_rate_reduction", "exceed_jnd_fraction", "rmse_n",
    "send_jump_mean_jnd", "nanoseconds_per_sample",
)  # fmt: skip
LARGEST: Final = ("exceed_jnd_fraction", "send_jump_max_jnd", "energy_peak_j", "over_optimum")


def codecs(thresholds: Iterable[float], steps_n: Iterable[float]) -> list[Codec]:
    """Return every codec at every threshold, with every payload it knows; raw once."""
    made = []
    for multiplier, (index, step_n) in itertools.product(thresholds, enumerate(steps_n)):
        law = WeberLaw(multiplier=multiplier)
        for name in CODECS:
            stepped = "step_n" in codec_parameters(make_codec(name, law))
            if (stepped or index == 0) and (name != "raw" or not made):
                made.append(make_codec(name, law, {"step_n": step_n} if stepped else None))
    return made


def compared(trials: Sequence[Trial], chosen: Sequence[Codec], losses: Iterable[float], seed: int) -> list[Row]:
    """Return a row for every signal, codec and loss."""
    rows = []
    for loss in losses:
        for row in compare(trials, chosen, loss=loss, seed=seed):
            flat = row.flat()
            rows.append({**{key: flat[key] for key in KEPT}, "step_n": row.parameters.get("step_n", 0.0), "loss": loss})
    return rows


def group(trial: str) -> str:
    """Return what a signal counts as in an average: the paper's scene is one, whatever the number of its seeds."""
    return "paper's scene" if trial.startswith("paper's scene") else trial


def averages(rows: Sequence[Row]) -> list[Row]:
    """Return means over the signals, each signal counting alike, and the largest over all."""
    key = itemgetter("loss", "multiplier", "step_n", "codec")
    means = []
    for (loss, multiplier, step_n, codec), found in itertools.groupby(sorted(rows, key=key), key=key):
        block = list(found)
        groups: dict[str, list[Row]] = {}
        for row in block:
            groups.setdefault(group(row["trial"]), []).append(row)
        mean = {"loss": loss, "multiplier": multiplier, "step_n": step_n, "codec": codec}
        for name in MEANS:
            mean[name] = statistics.fmean(statistics.fmean(row[name] for row in members) for members in groups.values())
        for name in LARGEST:
            # An infinite jump has become None, as in a law without a floor.
            mean[f"largest_{name}"] = max((row[name] for row in block if row[name] is not None), default=None)
        means.append(mean)
    return means


def contest(rows: Sequence[Row]) -> list[Row]:
    """Return who sends the fewest packets and the fewest bytes without loss, on each signal at each threshold.

    Only codecs take part that keep to 1 JND on that signal when it is their threshold.
    """
    lossless = [row for row in rows if not row["loss"] and row["codec"] != "raw"]
    thresholds = sorted({row["multiplier"] for row in lossless})
    strict = {
        (row["trial"], row["codec"], row["step_n"])
        for row in lossless
        if row["multiplier"] == 1.0 and row["exceed_jnd_fraction"] == 0.0
    }
    best = []
    for trial, multiplier in itertools.product(dict.fromkeys(row["trial"] for row in rows), thresholds):
        able = [
            row
            for row in lossless
            if (row["trial"], row["multiplier"]) == (trial, multiplier)
            and (trial, row["codec"], row["step_n"]) in strict
        ]
        plain = next(row for row in able if row["codec"] == "deadband")
        entry: Row = {"trial": trial, "multiplier": multiplier}
        for name, measure in (("packets", "sent"), ("bytes", "wire_bytes")):
            first, *others = sorted(able, key=itemgetter(measure))
            rival = next((row for row in others if row["codec"] != first["codec"]), first)
            entry[name] = {
                "codec": first["codec"],
                "step_n": first["step_n"],
                "value": first[measure],
                "over_optimum": first["over_optimum"],
                "of_deadband": first[measure] / max(plain[measure], 1),
                "second": rival["codec"],
                "of_second": first[measure] / max(rival[measure], 1),
            }
        best.append(entry)
    return best


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


def measure(trials: Sequence[Trial], seed: int, *, quick: bool) -> Row:
    """Return all results."""
    thresholds, steps_n, losses = ((1.0,), (0.0,), (0.0, 0.05)) if quick else (THRESHOLDS, STEPS_N, LOSSES)
    rows = compared(trials, codecs(thresholds, steps_n), losses, seed)
    strong = [
        trial
        for trial in trials
        if trial.name == KINESTHETIC or np.linalg.norm(trial.stimuli, axis=1).max() >= KINESTHETIC_PEAK_N
    ]
    return {
        "repair_us": REPAIR_US,
        "signals": [
            {
                "name": trial.name,
                "samples": len(trial.t_us),
                "seconds": trial.seconds,
                "axes": trial.stimuli.shape[1],
                "peak_n": float(np.linalg.norm(trial.stimuli, axis=1).max()),
                "has_position": trial.positions is not None,
            }
            for trial in trials
        ],
        "rows": rows,
        "averages": averages(rows),
        "contest": contest(rows),
        "regimes": regimes(strong, (1.0, 4.0) if quick else REGIME_THRESHOLDS),
        "payloads": payloads(trials, thresholds),
    }


def show(results: Row) -> None:
    """Print the averages without loss, and the winners."""
    print(f"{'without loss, mean over signals':34}{'× optimum':>10}{'kB/s':>8}{'exceed':>8}{'RMSE N':>8}"
          f"{'jump':>6}{'max':>7}{'mJ':>8}{'µs':>6}")  # fmt: skip
    for mean in results["averages"]:
        if not mean["loss"]:
            name = f"{mean['codec']}, {1000 * mean['step_n']:g} mN" if mean["step_n"] else mean["codec"]
            jump, energy_j = mean["largest_send_jump_max_jnd"], mean["largest_energy_peak_j"]
            print(
                f"{mean['multiplier']:4g} JND  {name:25}{mean['over_optimum']:10.2f}"
                f"{mean['wire_bytes_per_s'] / 1000:8.2f}{mean['exceed_jnd_fraction']:8.1%}{mean['rmse_n']:8.4f}"
                f"{mean['send_jump_mean_jnd']:6.1f}{'–' if jump is None else f'{jump:.1f}':>7}"
                f"{'–' if energy_j is None else f'{1e3 * energy_j:.2f}':>8}{mean['nanoseconds_per_sample'] / 1000:6.1f}"
            )
    print("\nfewest packets, fewest bytes at zero exceedance")
    for entry in results["contest"]:
        fewest = "   ".join(
            f"{entry[name]['codec']:20} {entry[name]['of_deadband']:.2f} of deadband" for name in ("packets", "bytes")
        )
        print(f"{entry['multiplier']:4g} JND  {entry['trial']:20}{fewest}")
    for row in results["regimes"]:
        at = row["reached_at"]
        print(f"{row['trial']}: {row['codec']} {row['published']:.0%}: "
              + ("not reached" if at is None else f"at k = {at:.1%}"))  # fmt: skip
    savings = [row["saving"] for row in results["payloads"]]
    print(f"entropy-coded payload saves {min(savings):.1%} to {max(savings):.1%} of linear-predictive's wire bytes")


def main() -> None:
    """Measure, print and, if asked, write the record."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "recordings", nargs="*", metavar="FILE[:FORCE[:POSITION[:SCALE]]]", help="recordings; SCALE in m per unit"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to this file")
    parser.add_argument("--seeds", type=int, default=3, help="how many orders of tissues and hands")
    parser.add_argument("--seed", type=int, default=1, help="the first of them, and the seed of all else")
    parser.add_argument("--seconds", type=float, default=15.0, help="length of each made signal")
    parser.add_argument("--quick", action="store_true", help="2 s, one scene, one threshold, float32 only")
    arguments = parser.parse_args()
    if arguments.seeds < 1 or not 1.0 <= arguments.seconds <= 1e4:
        parser.error("--seeds must be 1 or more, and --seconds from 1 to 1e4")
    seeds = range(arguments.seed, arguments.seed + (1 if arguments.quick else arguments.seeds))
    try:
        trials = [
            *paper_signals(seeds, 1 if arguments.quick else 2),
            *made_signals(arguments.seed, 2.0 if arguments.quick else arguments.seconds),
            *map(recorded_signal, arguments.recordings),
        ]
        results = measure(trials, arguments.seed, quick=arguments.quick)
    except HapticnetError as error:
        parser.error(str(error))
    show(results)
    if arguments.json:
        record.write(
            arguments.json,
            name="rate_distortion",
            seed=arguments.seed,
            unit="as in each name; wire bytes with UDP and IPv4 headers, fractions and reductions 0 to 1",
            repetitions=len(seeds),
            results=results,
        )


if __name__ == "__main__":
    main()
