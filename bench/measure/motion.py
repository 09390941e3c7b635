"""What each part of the codec motion-predictive buys: packets and felt force with some of its predictors alone.

The signals are those of felt.py. A predictor is left out by letting the codec believe that it has needed infinitely
many packets. "Positions in reverse" is a control: the positions of the same recording, but from its end to its start,
so that they say nothing about the force.
"""

import argparse
import math
import statistics
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import record
from felt_signals import KINDS, signals

from hapticnet.channel.settings import ChannelSettings
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import make_codec
from hapticnet.codec.schemes.motion_predictive import MotionPredictive, Sender, start
from hapticnet.codec.steps import Steps
from hapticnet.experiment.comparison import REPAIR_US
from hapticnet.experiment.trials import Trial
from hapticnet.measure.bound import fewest_holds
from hapticnet.measure.metrics import error_report
from hapticnet.node.closed_loop import simulate_link
from hapticnet.perception import WeberLaw

Row = dict[str, Any]

PREDICTORS: Final = ("surface", "coupling", "curve", "hold")
"""In the order of `Predictors.packets`."""

DELAY_MS: Final = 25
MULTIPLIERS: Final = (1.0, 2.0, 4.0)


def with_only(kept: Sequence[str], law: WeberLaw) -> Codec:
    """Return the codec with some of its predictors."""

    def starting(rule: Any, axes: int) -> Sender:
        is_known, motion, line, newest, predictors, rival, felt = start(rule, axes)
        surface, coupling, curve, hold = (0.0 if name in kept else math.inf for name in PREDICTORS)
        predictors = predictors._replace(packets=(surface, coupling, curve, hold))
        return is_known, motion, line, newest, predictors, rival, felt

    class Ablated(MotionPredictive):
        steps: Steps = MotionPredictive.steps._replace(start_sender=starting)  # type: ignore[misc]

    return Ablated(law=law)


def variants(law: WeberLaw) -> dict[str, Codec]:
    """Return every codec that is tried, by name."""
    alone = {f"{name} alone": with_only([name], law) for name in PREDICTORS}
    without = {f"without {name}": with_only([each for each in PREDICTORS if each != name], law) for name in PREDICTORS}
    peers = {name: make_codec(name, law) for name in ("deadband", "adaptive-predictive")}
    return {"all four": MotionPredictive(law=law), **alone, **without, **peers}


def measure(arguments: argparse.Namespace) -> Row:
    """Return a row for every signal, threshold and variant, and means over each kind of signal."""
    seed, quick = arguments.seed, arguments.quick
    found = signals(range(seed, seed + 1), arguments.recordings, arguments.seconds)
    if quick:
        found = [(kind, trial) for kind, trial in found if "slow" in trial.name]
    found += [(f"{kind}, positions in reverse", reversed_positions(trial)) for kind, trial in found]
    rows = []
    for multiplier in MULTIPLIERS[: 1 if quick else None]:
        law = WeberLaw(multiplier=multiplier)
        for kind, trial in found:
            rows += [played(trial, kind, name, codec) for name, codec in variants(law).items()]
    return {"delay_ms": DELAY_MS, "multipliers": MULTIPLIERS, "rows": rows, "means": means(rows)}


def reversed_positions(trial: Trial) -> Trial:
    """Return a trial whose positions say nothing about the force."""
    assert trial.positions is not None
    return Trial(name=trial.name, t_us=trial.t_us, stimuli=trial.stimuli, positions=trial.positions[::-1].copy())


def played(trial: Trial, kind: str, variant: str, codec: Codec) -> Row:
    """Return the packets of a signal, and how it feels with a delay."""
    assert trial.positions is not None
    link = ChannelSettings(delay_us=1000 * DELAY_MS)
    felt = simulate_link(
        codec, trial.t_us, trial.stimuli, trial.positions, forward=link, feedback=link,
        repair_us=REPAIR_US + 2 * link.delay_us, rng=np.random.default_rng(1),
    )  # fmt: skip
    one_jnd = WeberLaw()
    return {
        "kind": kind,
        "signal": trial.name,
        "variant": variant,
        "multiplier": codec.law.multiplier,
        "packets": felt.sent,
        "over_optimum": felt.sent / fewest_holds(codec.law, trial.stimuli),
        "felt_exceed_jnd_fraction": error_report(one_jnd, trial.stimuli, felt.applied).exceed_jnd_fraction,
    }


def means(rows: Sequence[Row]) -> list[Row]:
    """Return for each kind and variant the packets relative to all four predictors (geometric mean), and the error."""
    whole = {
        (row["kind"], row["signal"], row["multiplier"]): row["packets"] for row in rows if row["variant"] == "all four"
    }
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["kind"], row["variant"]), []).append(row)
    return [
        {
            "kind": kind,
            "variant": variant,
            "over_all_four": statistics.geometric_mean(
                row["packets"] / whole[kind, row["signal"], row["multiplier"]] for row in group
            ),
            "over_optimum": statistics.geometric_mean(row["over_optimum"] for row in group),
            "felt_exceed_jnd_fraction": statistics.fmean(
                row["felt_exceed_jnd_fraction"] for row in group if row["multiplier"] == MULTIPLIERS[0]
            ),
        }
        for (kind, variant), group in sorted(groups.items(), key=lambda item: KINDS.index(item[0][0].split(",")[0]))
    ]


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument(
        "recordings", nargs="*", metavar="FILE[:FORCE[:POSITION[:SCALE]]]", help="recordings; SCALE in m per unit"
    )
    parser.add_argument("--seconds", type=record.within(1.0, 1e4), default=10.0, help="most of each recording")
    parser.set_defaults(repetitions=1)
    parser.add_argument("--quick", action="store_true", help="one signal, one threshold")
    record.run(parser, measure, unit="packets, shares 0 to 1")


if __name__ == "__main__":
    main()
