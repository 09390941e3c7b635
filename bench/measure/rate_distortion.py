"""Every codec over every signal, threshold, payload and loss: what it sends, what error that costs, how far from best.

Beside the table: who does with the fewest packets and bytes on each signal, whether the reductions that are published
are reached on a force of that scale, and what entropy coding of the payload can save under the headers of a packet.
"""

import argparse
import itertools
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
import record
from rate_distortion_claims import VARIANTS, mean, payloads, rates, regimes, settings, steps
from rate_distortion_signals import KINESTHETIC, made_signals, paper_signals, recorded_signals

from hapticnet.codec.base import Codec
from hapticnet.codec.registry import CODECS, codec_parameters, make_codec
from hapticnet.errors import HapticnetError
from hapticnet.experiment.comparison import REPAIR_US, Trial, compare
from hapticnet.experiment.comparison import Row as ComparisonRow
from hapticnet.measure.bound import fewest_holds
from hapticnet.node.offline import cost_report
from hapticnet.perception import WeberLaw

Row = dict[str, Any]
Fewest = dict[tuple[str, WeberLaw], int]

THRESHOLDS: Final = (0.5, 1.0, 2.0, 4.0)
STEPS_N: Final = (0.0, 0.001)
LOSSES: Final = (0.05, 0.1, 0.3)
LOSS_SEEDS: Final = 10
"""How many channels that lose are tried, at 1 JND with float32 payloads."""
NEAR: Final = (0.94, 0.97, 1.03, 1.06)
"""Factors of the thresholds beside each: at one threshold alone, luck moves the number of packets by some per cent."""
REGIME_THRESHOLDS: Final = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
KINESTHETIC_PEAK_N: Final = 10.0

KEPT: Final = (
    "trial", "codec", "multiplier", "samples", "sent", "over_optimum", "optimum_holds", "optimum_lines",
    "packet_rate_reduction", "packets_per_s", "wire_bytes", "wire_bytes_per_s", "session_wire_bytes_per_s",
    "exceed_jnd_fraction", "rmse_n",
    "max_error_n", "psnr_db", "hpw_psnr_db", "perceptual_mse", "send_jump_mean_jnd", "send_jump_max_jnd",
    "age_mean_us", "worst_100ms_packets", "energy_peak_j", "nanoseconds_per_sample",
)  # fmt: skip
MEANS: Final = (
    "near_over_optimum", "near_wire_bytes_per_s", "over_optimum", "over_lines", "packets_per_s", "wire_bytes_per_s",
    "session_wire_bytes_per_s",
    "packet_rate_reduction", "exceed_jnd_fraction", "rmse_n", "psnr_db", "hpw_psnr_db", "perceptual_mse",
    "send_jump_mean_jnd", "age_mean_us", "nanoseconds_per_sample",
)  # fmt: skip
NEARBY: Final = ("near_sent", "near_over_optimum", "near_wire_bytes", "near_wire_bytes_per_s")
LARGEST: Final = (
    "exceed_jnd_fraction", "max_error_n", "send_jump_max_jnd", "worst_100ms_packets", "energy_peak_j", "over_optimum",
)  # fmt: skip

AIMED_AT: Final = "paper's scene and recordings"
SETS: Final = {AIMED_AT: ("scene", "recorded"), "made signals": ("made",)}
"""What is averaged over, and which kinds of signal are in it. The first is what our codec was aimed at."""


def codecs(thresholds: Iterable[float], steps_n: Iterable[float]) -> list[Codec]:
    """Return every codec at every threshold, with every payload it knows; raw once."""
    made: list[Codec] = []
    for multiplier, (index, step_n) in itertools.product(thresholds, enumerate(steps_n)):
        law = WeberLaw(multiplier=multiplier)
        for name in CODECS:
            stepped = "step_n" in codec_parameters(make_codec(name, law))
            if (stepped or index == 0) and (name != "raw" or not made):
                made.append(make_codec(name, law, {"step_n": step_n} if stepped else None))
    return made


def lossless(trials: Sequence[Trial], chosen: Sequence[Codec], beside: Sequence[float]) -> list[Row]:
    """Return a row for every signal and codec without loss, packets and bytes also averaged over `beside`."""
    fewest: Fewest = {}
    pairs = itertools.product(trials, chosen)
    rows = [(kept(row), trial, codec) for row, (trial, codec) in zip(compare(trials, chosen), pairs, strict=True)]
    return [row | averaged(trial, codec, row, beside, fewest) for row, trial, codec in rows]


def lossy(trials: Sequence[Trial], losses: Iterable[float], seeds: Iterable[int]) -> list[Row]:
    """Return a row for every signal, codec, loss and seed of what is lost, at 1 JND with float32 payloads."""
    chosen = codecs((1.0,), (0.0,))
    return [
        kept(row) | dict.fromkeys(NEARBY) | {"loss": loss, "seed": seed}
        for loss, seed in itertools.product(losses, seeds)
        for row in compare(trials, chosen, loss=loss, seed=seed)
    ]


def kept(row: ComparisonRow) -> Row:
    """Return what is recorded of a row."""
    flat = row.flat()
    own = {"step_n": row.parameters.get("step_n", 0.0), "loss": 0.0, "over_lines": row.cost.sent / row.limits.lines}
    return {key: flat[key] for key in KEPT} | own


def averaged(trial: Trial, codec: Codec, row: Row, beside: Sequence[float], fewest: Fewest) -> Row:
    """Return packets, over the optimum too, and bytes in the mean over a threshold and those beside it.

    `fewest` keeps the fewest holds of a signal under a law, which are the same for all codecs.
    """
    found = [[row["sent"]], [row["over_optimum"]], [row["wire_bytes"]]]
    for factor in beside if codec.name != "raw" else ():
        law = replace(codec.law, multiplier=factor * codec.law.multiplier)
        near = make_codec(codec.name, law, codec_parameters(codec))
        if (trial.name, law) not in fewest:
            fewest[trial.name, law] = fewest_holds(law, trial.stimuli)
        encoding = near.encode_array(trial.t_us, trial.stimuli, trial.positions)
        sent, wire_bytes = len(encoding.sent), cost_report(near, trial.t_us, trial.stimuli, encoding).wire_bytes
        for values, value in zip(found, (sent, sent / fewest[trial.name, law], wire_bytes), strict=True):
            values.append(value)
    means = [statistics.fmean(values) for values in found]
    return dict(zip(NEARBY, (*means, means[-1] / trial.seconds), strict=True))


def averages(rows: Sequence[Row], kinds: Mapping[str, str]) -> list[Row]:
    """Return means over each set of signals and the largest in it; `kinds` says what each signal is."""
    key = itemgetter("loss", "multiplier", "step_n", "codec")
    means = []
    for name, members in SETS.items():
        inside: dict[tuple[float, float, float, str], list[Row]] = {}
        for row in rows:
            if kinds[row["trial"]] in members:
                inside.setdefault(key(row), []).append(row)
        for (loss, multiplier, step_n, codec), block in inside.items():
            made = {"signals": name, "loss": loss, "multiplier": multiplier, "step_n": step_n, "codec": codec}
            for figure in MEANS:
                values = [(kinds[row["trial"]], row["trial"], row[figure]) for row in block]
                # What is infinite has become None, as a jump where the law has no floor; or it was not measured.
                made[figure] = None if any(value is None for *_, value in values) else mean(values)
            for figure in LARGEST:
                made[f"largest_{figure}"] = max((row[figure] for row in block if row[figure] is not None), default=None)
            means.append(made)
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
        for name, measure in (("packets", "near_sent"), ("bytes", "near_wire_bytes")):
            first = min(able, key=itemgetter(measure))
            entry[name] = {
                "codec": first["codec"],
                "step_n": first["step_n"],
                "value": first[measure],
                "over_optimum": first["near_over_optimum"],
                "of_deadband": first[measure] / max(plain[measure], 1),
            }
        best.append(entry)
    return best


def measure(signals: Mapping[str, Sequence[Trial]], seed: int, *, quick: bool) -> Row:
    """Return all results on the signals of each kind."""
    kinds = {trial.name: kind for kind, members in signals.items() for trial in members}
    trials = [trial for members in signals.values() for trial in members]
    aimed_at = [trial for trial in trials if kinds[trial.name] in SETS[AIMED_AT]]
    thresholds, steps_n, losses = ((1.0,), (0.0,), (0.05,)) if quick else (THRESHOLDS, STEPS_N, LOSSES)
    beside, seeds = ((), range(seed, seed + 1)) if quick else (NEAR, range(seed, seed + LOSS_SEEDS))
    rows = lossless(trials, codecs(thresholds, steps_n), beside) + lossy(trials, losses, seeds)
    strong = [
        trial
        for trial in trials
        if trial.name == KINESTHETIC or np.linalg.norm(trial.stimuli, axis=1).max() >= KINESTHETIC_PEAK_N
    ]
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
                "peak_n": float(np.linalg.norm(trial.stimuli, axis=1).max()),
                "has_position": trial.positions is not None,
            }
            for trial in trials
        ],
        "rows": rows,
        "sets": SETS,
        "averages": averages(rows, kinds),
        "contest": contest(rows),
        "regimes": regimes(strong, (1.0, 4.0) if quick else REGIME_THRESHOLDS),
        "payloads": payloads(trials, thresholds),
        "steps": steps(aimed_at, kinds),
        "settings": settings(trials, kinds, beside, VARIANTS),
        "rates": rates(trials, kinds, beside),
    }


def show(results: Row) -> None:
    """Print the averages without loss, and the winners."""
    for name in SETS:
        print(f"\n{f'without loss, mean over {name}':64}{'× optimum':>10}{'kB/s':>8}{'exceed':>8}{'RMSE N':>8}"
              f"{'jump':>6}{'max':>7}{'mJ':>8}{'µs':>6}")  # fmt: skip
        for row in results["averages"]:
            if row["signals"] == name and not row["loss"]:
                codec = f"{row['codec']}, {1000 * row['step_n']:g} mN" if row["step_n"] else row["codec"]
                jump, energy_j = row["largest_send_jump_max_jnd"], row["largest_energy_peak_j"]
                print(
                    f"{row['multiplier']:4g} JND  {codec:54}{row['over_optimum']:10.2f}"
                    f"{row['wire_bytes_per_s'] / 1000:8.2f}{row['exceed_jnd_fraction']:8.1%}{row['rmse_n']:8.4f}"
                    f"{row['send_jump_mean_jnd']:6.1f}{'–' if jump is None else f'{jump:.1f}':>7}"
                    f"{'–' if energy_j is None else f'{1e3 * energy_j:.2f}':>8}"
                    f"{row['nanoseconds_per_sample'] / 1000:6.1f}"
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
        signals = {
            "scene": paper_signals(seeds, 1 if arguments.quick else 2),
            "recorded": recorded_signals(arguments.recordings),
            "made": made_signals(arguments.seed, 2.0 if arguments.quick else arguments.seconds),
        }
        results = measure(signals, arguments.seed, quick=arguments.quick)
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
