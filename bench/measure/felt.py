"""What a hand feels over a network: every codec over every delay, with jitter and loss, on scenes and recordings.

At every tick of the master, the force that is applied is compared with the true force of the position at that tick;
see `hapticnet.node.closed_loop`. Beside it: the energy that the applied force creates; see `hapticnet.measure.energy`.
No sessions are played: neither keepalives nor the decay of a stale link count.
"""

import argparse
import itertools
import statistics
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Final
from unittest import mock

import numpy as np
import record
from codec_trials import force_codecs
from felt_signals import KINDS, signals

from hapticnet.channel.settings import BernoulliLoss, ChannelSettings, Jitter
from hapticnet.codec.registry import make_codec
from hapticnet.experiment.comparison import REPAIR_US
from hapticnet.experiment.trials import Trial
from hapticnet.measure.energy import energy_report
from hapticnet.measure.metrics import FeltReport, error_report
from hapticnet.node import hand_predictor
from hapticnet.node.closed_loop import simulate_link
from hapticnet.perception import WeberLaw
from hapticnet.scene.sources import make_scene

CODECS = force_codecs()

Row = dict[str, Any]

DELAYS_MS: Final = (0, 5, 10, 25, 50, 100)
"""One-way delays."""

DISTURBED_MS: Final = (5, 25, 50)
"""One-way delays that are tried with jitter and with loss too."""

JITTER: Final = Jitter(distribution="normal", deviation_us=5_000)
LOSS: Final = BernoulliLoss(0.05)
LINKS: Final = {"delay alone": (None, None), "jitter of 5 ms": (JITTER, None), "5 % loss": (None, LOSS)}
"""Disturbances of both directions in addition to the delay."""

LARGEST_OWN_SHARE: Final = 0.05
"""Energy is given for signals whose true force itself creates less than this share. Some recordings exceed it:
something else drives the tool, or position and force were measured at different places."""

ERRORS: Final = tuple(FeltReport.__dataclass_fields__)
FIGURES: Final = (*ERRORS, "created_share", "active_share", "packets_per_s")
MAIN: Final = ("raw", "deadband", "adaptive-predictive", "motion-predictive")
"""Codecs that are tried with passivity control at the master, too, and with prediction of the hand at the slave; see
`hapticnet.control.hold` and `hapticnet.node.hand_predictor`."""

ABLATED: Final[dict[str, dict[str, float]]] = {
    "least squares": {},
    "the same, forgetting within 0.2 s": {"MEMORY_S": 0.2},
    "the same, with no limit of the speed": {"FASTEST": 1e9, "LARGEST_SPEED_M_PER_S": 1e9},
    "a velocity that dies out": {"RIDGE": 1e12},
}
"""Predictors of the hand: constants of `node.hand_predictor` that are changed. With the last, nothing is learned."""


def ablated(found: Sequence[tuple[str, Trial]], seed: int) -> list[Row]:
    """Return means for each predictor of the hand, over 25 ms each way, if every force is sent."""
    rows = []
    for name, constants in ABLATED.items():
        with ExitStack() as stack:
            for constant, value in constants.items():
                stack.enter_context(mock.patch.object(hand_predictor, constant, value))
            for kind, trial in found:
                if trial.scene is not None:
                    rows.append(felt(trial, kind, "raw", "delay alone", 25, seed, predicted=True) | {"codec": name})
    return means(rows)


def measure(arguments: argparse.Namespace) -> Row:
    """Return a row for every signal, codec, link and delay, and their means over each kind of signal."""
    seed, quick = arguments.seed, arguments.quick
    seeds = range(seed, seed + (1 if quick else arguments.seeds))
    found = signals(seeds, arguments.recordings, arguments.seconds)
    delays_ms, disturbed_ms = ((0, 25), ()) if quick else (DELAYS_MS, DISTURBED_MS)
    if quick:
        found = [(kind, trial) for kind, trial in found if "slow" in trial.name or "friction" in trial.name]
    links = [("delay alone", delay_ms) for delay_ms in delays_ms]
    links += list(itertools.product(list(LINKS)[1:], disturbed_ms))
    rows = [
        felt(trial, kind, codec, link, delay_ms, seed)
        for (kind, trial), codec, (link, delay_ms) in itertools.product(found, CODECS, links)
    ]
    predicted = [
        felt(trial, kind, codec, link, delay_ms, seed, predicted=True)
        for (kind, trial), codec, link, delay_ms in itertools.product(found, MAIN, LINKS, disturbed_ms or (25,))
        if trial.scene is not None
    ]
    return {
        "delays_ms": delays_ms,
        "repair_us": REPAIR_US,
        "signals": [{"name": trial.name, "kind": kind, **account(trial)} for kind, trial in found],
        "rows": rows,
        "means": means(rows),
        "predicted": means(predicted),
        "ablated": ablated(found, seed),
    }


def felt(
    trial: Trial,
    kind: str,
    codec: str,
    link: str,
    delay_ms: int,
    seed: int,
    *,
    predicted: bool = False,
) -> Row:
    """Return what a hand feels of one signal through one codec at 1 JND over one link, and at what cost."""
    assert trial.positions is not None
    jitter, loss = LINKS[link]
    channel = ChannelSettings(delay_us=1000 * delay_ms, jitter=jitter, loss=loss)
    law = WeberLaw()
    played = simulate_link(
        make_codec(codec, law),
        trial.t_us,
        trial.stimuli,
        trial.positions,
        forward=channel,
        feedback=channel,
        repair_us=REPAIR_US + 2 * channel.delay_us,
        rng=np.random.default_rng(seed),
        scene=make_scene(trial.scene) if predicted and trial.scene is not None else None,
    )
    errors = error_report(law, trial.stimuli, played.applied)
    own = energy_report(law, trial.stimuli, trial.stimuli, trial.positions)
    energy = energy_report(law, trial.stimuli, played.applied, trial.positions)
    tells = own.put_in_j > 0.0 and own.active_share < LARGEST_OWN_SHARE
    return {
        "signal": trial.name,
        "kind": kind,
        "codec": codec,
        "link": link,
        "delay_ms": delay_ms,
        **{name: getattr(errors, name) for name in ERRORS},
        "created_share": energy.created_share if tells else None,
        "active_share": energy.active_share if tells else None,
        "packets_per_s": played.sent / trial.seconds,
    }


def means(rows: Sequence[Row]) -> list[Row]:
    """Return the means of the figures over the signals of each kind."""
    groups: dict[tuple[str, str, str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["kind"], row["codec"], row["link"], row["delay_ms"]), []).append(row)
    return [
        dict(zip(("kind", "codec", "link", "delay_ms"), key, strict=True))
        | {figure: _mean([row[figure] for row in group if row[figure] is not None]) for figure in FIGURES}
        for key, group in sorted(groups.items(), key=lambda item: KINDS.index(item[0][0]))
    ]


def _mean(values: Sequence[float]) -> float | None:
    return statistics.fmean(values) if values else None


def account(trial: Trial) -> Row:
    """Return what a signal is like."""
    assert trial.positions is not None
    own = energy_report(WeberLaw(), trial.stimuli, trial.stimuli, trial.positions)
    speeds = np.linalg.norm(np.diff(trial.positions, axis=0), axis=1) / np.maximum(np.diff(trial.t_us), 1) * 1e6
    return {
        "seconds": trial.seconds,
        "axes": trial.stimuli.shape[1],
        "peak_n": float(np.linalg.norm(trial.stimuli, axis=1).max()),
        "fastest_m_per_s": float(np.percentile(speeds, 99.9)),
        "put_in_j": own.put_in_j,
        "own_active_share": own.active_share,
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument(
        "recordings", nargs="*", metavar="FILE[:FORCE[:POSITION[:SCALE]]]", help="recordings; SCALE in m per unit"
    )
    parser.add_argument("--seeds", type=record.within(1), default=2, help="number of orders of tissues and of hands")
    parser.add_argument("--seconds", type=record.within(1.0, 1e4), default=10.0, help="longest part of each recording")
    parser.add_argument("--quick", action="store_true", help="two signals, two delays")
    record.run(parser, measure, unit="as in each name; shares 0 to 1, energy as a share of the work of the hand")


if __name__ == "__main__":
    main()
