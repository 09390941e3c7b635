"""What the deadband saves and the error it costs, over sampling rates and insertion speeds.

The paper states neither its sampling rate nor its motion, and its 61.7 % depends on both. This measures the curve and
where 61.7 % lies on it; nothing is tuned to meet it. All is computed from the true force of the slave's scene, which
one run of both nodes in virtual time confirms.
"""

import argparse
import itertools
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from operator import itemgetter
from typing import Any

import numpy as np
import record
from virtual_time import both_nodes

from hapticnet.codec.base import Codec
from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import make_codec
from hapticnet.experiment.analysis import CONDITIONS, Columns, Condition, bytes_per_penetration
from hapticnet.experiment.trials import paper_trial
from hapticnet.measure.metrics import error_report
from hapticnet.node.offline import force_datagram_bytes
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import PAPER_FLOOR_N, WeberLaw
from hapticnet.protocol.wire import Kind

NONE, ONE_JND = CONDITIONS[:2]
PAPER_REDUCTION = ONE_JND.paper_byte_reduction or 0.0
RATES_HZ = (50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)
CHECKED_HZ = 1000.0
PUSHES_S = (0.6, 1.2, 2.4, 4.8)
START_US = 1_000_000  # on the master's clock; from 65.5 ms on a time stamp takes all of its five bytes

Row = dict[str, Any]


def true_forces(seed: int, motion: InsertionSettings, rate_hz: float) -> Columns:
    """Return the true force at every position of one seed's hand in its scene, as recorded by a slave."""
    true = paper_trial(seed, rate_hz, motion=motion)
    assert true.positions is not None
    force_n = true.stimuli[:, 0]
    # Each tissue is breached before the next one is touched, so each contact ends with a breach.
    breached = np.diff(np.sign(force_n), prepend=0.0) < 0.0
    return {
        "t_us": true.t_us + float(START_US),
        "position_m": true.positions[:, 0],
        "force_n": force_n,
        "breaches": np.cumsum(breached).astype(float),
    }


def encoded(codec: Codec, true: Columns) -> Columns:
    """Return what the slave records when `codec` compresses the true forces."""
    t_us = true["t_us"].astype(np.int64)
    encoding = encode_array(codec, t_us, true["force_n"][:, np.newaxis])
    sequence = np.arange(1, len(encoding.sent) + 1)  # the WELCOME takes 0
    datagram_bytes = np.zeros(len(t_us))
    datagram_bytes[encoding.sent] = force_datagram_bytes(sequence, t_us[encoding.sent], encoding.payload_bytes)
    return {**true, "held_n": encoding.decoded[:, 0], "datagram_bytes": datagram_bytes}


def account(law: WeberLaw, runs: Sequence[Columns]) -> Row:
    """Return cost and error of one condition, over the recordings of all seeds."""
    each = [cost for run in runs for cost in bytes_per_penetration(run).each]
    true_n, held_n = (np.concatenate([run[name] for run in runs]) for name in ("force_n", "held_n"))
    packets = sum(int(np.count_nonzero(run["datagram_bytes"])) for run in runs)
    return {
        "samples": len(true_n),
        "packets": packets,
        "packet_rate_reduction": 1.0 - packets / len(true_n),
        "penetrations": len(each),
        "bytes_per_penetration_mean": float(np.mean(each)),
        "bytes_per_penetration_sd": float(np.std(each, ddof=1)),
        **asdict(error_report(law, true_n[:, np.newaxis], held_n[:, np.newaxis])),
    }


def compared(
    conditions: Sequence[Condition],
    seeds: Sequence[int],
    motion: InsertionSettings,
    *,
    rate_hz: float,
    floor_n: float = PAPER_FLOOR_N,
) -> list[Row]:
    """Return one row per condition; the first, "none", is the reference for the others."""
    true = [true_forces(seed, motion, rate_hz) for seed in seeds]
    rows: list[Row] = []
    for condition in conditions:
        law = WeberLaw(floor_n=floor_n, multiplier=condition.multiplier)
        codec = make_codec(condition.codec, law)
        row = {"rate_hz": rate_hz, "condition": condition.name, **account(law, [encoded(codec, run) for run in true])}
        full = rows[0] if rows else row
        row["byte_reduction"] = 1.0 - row["bytes_per_penetration_mean"] / full["bytes_per_penetration_mean"]
        rows.append(row)
    return rows


def crossing_hz(rows: Sequence[Row]) -> float | None:
    """Return the sampling rate [Hz] at which the paper's reduction is first reached; None if it never is.

    The bytes that are left fall nearly as a power of the rate, so both are interpolated by their logarithms.
    """
    for slow, fast in itertools.pairwise(rows):
        if slow["byte_reduction"] < PAPER_REDUCTION <= fast["byte_reduction"]:
            left = [1.0 - reduction for reduction in (slow["byte_reduction"], PAPER_REDUCTION, fast["byte_reduction"])]
            share = math.log(left[0] / left[1]) / math.log(left[0] / left[2])
            return float(slow["rate_hz"] * (fast["rate_hz"] / slow["rate_hz"]) ** share)
    return None


def curve(seeds: Sequence[int], motion: InsertionSettings, *, floor_n: float = PAPER_FLOOR_N) -> Row:
    """Return the effect of 1 JND over the sampling rate, and where on this curve the paper's reduction falls."""

    def at(rate_hz: float) -> Row:
        return compared((NONE, ONE_JND), seeds, motion, rate_hz=rate_hz, floor_n=floor_n)[1]

    rows = [at(rate_hz) for rate_hz in RATES_HZ]
    for _ in range(2):  # measure again where the line between two rates crosses the paper's reduction
        if (rate_hz := crossing_hz(rows)) is not None:
            rows = sorted([*rows, at(rate_hz)], key=itemgetter("rate_hz"))
    return {
        "push_s": motion.push_s,
        "push_mm_per_s": 1e3 * (motion.depth_m - motion.approach_m) / motion.push_s,
        "crossing_hz": crossing_hz(rows),
        "rows": rows,
    }


def check(seed: int, motion: InsertionSettings) -> list[Row]:
    """Compare with both nodes in virtual time, over a perfect channel, at one rate."""
    true = true_forces(seed, motion, CHECKED_HZ)
    rows: list[Row] = []
    for condition in CONDITIONS:
        law = WeberLaw(multiplier=condition.multiplier)
        operator = ScriptedOperator(motion, np.random.default_rng(seed))
        settings = MasterSettings(codec=condition.codec, law=law, rate_hz=CHECKED_HZ, record=True)
        loopback = both_nodes(seed, operator, settings, start_us=START_US)
        loopback.run(operator.duration_us)
        (context,) = loopback.slave.contexts
        offline = account(law, [encoded(make_codec(condition.codec, law), true)])
        assert context.recording is not None
        table = context.recording.table()
        nodes = account(law, [{**table, "datagram_bytes": table["datagram_bytes"] * table["transmitted"]}])
        row: Row = {"condition": condition.name, "keepalives": context.session.sent.by_kind[Kind.KEEPALIVE]}
        for key in ("samples", "packets", "bytes_per_penetration_mean", "rmse_n"):
            row[key] = offline[key]
            row[f"{key}_difference"] = nodes[key] - offline[key]
        row["bytes_per_penetration_with_keepalives"] = bytes_per_penetration(table).mean
        rows.append(row)
    return rows


def measure(arguments: argparse.Namespace) -> Row:
    """Return all results."""
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    motion = InsertionSettings(insertions=arguments.insertions)
    arguments.repetitions = arguments.seeds * arguments.insertions
    return {
        "motion": asdict(motion),
        "paper_byte_reduction": PAPER_REDUCTION,
        "scene": [row for rate_hz in RATES_HZ for row in compared(CONDITIONS, seeds, motion, rate_hz=rate_hz)],
        "over_speeds": [curve(seeds, replace(motion, push_s=push_s)) for push_s in sorted({*PUSHES_S, motion.push_s})],
        "crossing_hz_of_seeds": [curve([seed], motion)["crossing_hz"] for seed in seeds],
        "without_floor": curve(seeds, motion, floor_n=0.0),
        "check": check(seeds[0], motion),
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seeds", type=record.within(1), default=5, help="how many orders of tissues and hands")
    parser.add_argument("--insertions", type=int, default=3, help="insertions of each, with three penetrations")
    record.run(
        parser, measure, unit="as in each name; bytes are B with UDP and IPv4 headers, reductions and fractions 0 to 1"
    )


if __name__ == "__main__":
    main()
