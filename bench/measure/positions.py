"""Positions that are only sent when they matter: their cost and the felt force, beside raw positions in the same run.

Both nodes play whole sessions in virtual time: every datagram is built, carried and parsed. In each tick of the master,
the force that is applied then is compared with the true force of the position of that tick. Without delay the answer to
a tick is applied one tick later, so a fast hand feels errors of raw positions too; tests/node/test_node_positions.py
tests the law after each answer.
"""

import argparse
import itertools
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import record
from virtual_time import both_nodes

from hapticnet.measure.metrics import error_report
from hapticnet.node.loopback import Loopback
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import Kind
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.scene.sources import paper_scene
from hapticnet.vectors import single

Row = dict[str, Any]

TAG_BYTES: Final = 16
"""What a seal adds to each datagram of a session."""

HANDS: Final = {
    "the paper's": InsertionSettings(insertions=2),
    "thrusts": InsertionSettings(insertions=4, approach_s=0.1, push_s=0.3, withdraw_s=0.3),
    "slow": InsertionSettings(insertions=1, push_s=8.0, push_steps=8, withdraw_s=2.0),
    "trembling": InsertionSettings(insertions=2, tremor_rms_m=2e-4),
}
"""Thrusts pass 200 mm/s."""

SCENES: Final = {
    "paper": {},
    "stiffening": {"stiffening_per_m": 100.0},
    "viscous": {"viscosity_n_s_per_m": 1.0},
}
"""Additional properties of the paper's tissues."""

CODECS: Final = ("deadband", "linear-predictive", "adaptive-predictive", "motion-predictive")
SHARES: Final = (0.1, 0.25, 0.5, 0.75, 0.9)
DELAYS_MS: Final = (0, 5, 25, 50)
LOSS: Final = "delay=25ms,loss=5%"
CHOSEN: Final = 0.25


@dataclass(frozen=True, slots=True)
class Case:
    """A session to play; `share` is None for raw positions."""

    hand: str = "the paper's"
    scene: str = "paper"
    codec: str = "adaptive-predictive"
    share: float | None = CHOSEN
    channel: str = "perfect"


def measure(arguments: argparse.Namespace) -> Row:
    """Return a row for every case."""
    seeds = range(arguments.seed, arguments.seed + (1 if arguments.quick else arguments.seeds))
    cases = quick() if arguments.quick else every()
    return {"tag_bytes": TAG_BYTES, "rows": [mean([played(case, seed) for seed in seeds]) for case in cases]}


def every() -> list[Case]:
    """Return the cases: codec by share, hand and scene without delay, and delays for two codecs."""
    share = [Case(codec=codec, share=share) for codec, share in itertools.product(CODECS, (None, *SHARES))]
    two = CODECS[-2:]
    hands = [
        Case(hand=hand, codec=codec, share=each)
        for hand, codec, each in itertools.product(list(HANDS)[1:], two, (None, CHOSEN, 0.5))
    ]
    scenes = [
        Case(scene=scene, codec=codec, share=each)
        for scene, codec, each in itertools.product(list(SCENES)[1:], two, (None, CHOSEN))
    ]
    channels = [*(f"delay={delay_ms}ms" for delay_ms in DELAYS_MS if delay_ms), LOSS]
    delays = [
        Case(codec=codec, share=each, channel=channel)
        for channel, codec, each in itertools.product(channels, ("deadband", *two), (None, CHOSEN))
    ]
    return [*share, *hands, *scenes, *delays]


def quick() -> list[Case]:
    """Return one case with and without delay, beside raw positions."""
    return [Case(share=share, channel=channel) for channel in ("perfect", "delay=25ms") for share in (None, CHOSEN)]


def played(case: Case, seed: int) -> Row:
    """Play a session; return its cost and the felt error."""
    tissues = tuple(replace(tissue, **SCENES[case.scene]) for tissue in paper_scene(seed).tissues)
    operator = ScriptedOperator(HANDS[case.hand], np.random.default_rng([seed, 1]))
    settings = MasterSettings(
        codec=case.codec,
        positions="raw" if case.share is None else "line",
        position_share=case.share or CHOSEN,
        record=True,
    )
    loop = both_nodes(seed, operator, settings, channel=case.channel, tissues=tissues)
    loop.run(operator.duration_us)
    return {"case": case, **cost(loop), **felt(loop, tissues)}


def cost(loop: Loopback) -> Row:
    """Return datagrams and bytes per second, with UDP and IPv4 headers, both ways."""
    master, seconds = loop.master, loop.master.ticks * loop.master.period_us / 1e6
    sent, received = master.session.sent, master.session.received
    keepalives, packets = received.by_kind[Kind.KEEPALIVE], sent.packets + received.packets
    return {
        "positions_per_s": sent.by_kind[Kind.POSITION] / seconds,
        "forces_per_s": received.by_kind[Kind.FORCE] / seconds,
        "keepalives_per_s": keepalives / seconds,
        "bytes_per_s": (sent.wire_bytes + received.wire_bytes) / seconds,
        "sealed_bytes_per_s": (sent.wire_bytes + received.wire_bytes + TAG_BYTES * packets) / seconds,
        "keepalive_share": 54.0 * keepalives / (sent.wire_bytes + received.wire_bytes),
        "between_per_s": loop.slave.contexts[0].between / seconds,
        "connections": master.connections,
    }


def felt(loop: Loopback, tissues: tuple[Tissue, ...]) -> Row:
    """Return the error of the held force in each tick."""
    assert loop.master.recording is not None
    table, scene = loop.master.recording.table(), Scene(tissues)
    true_n = [
        scene.step(PositionSample(int(t_us), single((float(tip_m),)))).force_n
        for t_us, tip_m in zip(table["t_us"], table["position_m"], strict=True)
    ]
    errors = error_report(WeberLaw(), np.array(true_n), table["held_n"][:, np.newaxis])
    return {
        "exceed_jnd_fraction": errors.exceed_jnd_fraction,
        "rmse_n": errors.rmse_n,
        "breaches": scene.breaches - loop.slave.contexts[0].report()["breaches"],
    }


def mean(rows: list[Row]) -> Row:
    """Return the means of the figures over the seeds."""
    case: Case = rows[0]["case"]
    figures = {key: float(np.mean([row[key] for row in rows])) for key in rows[0] if key != "case"}
    names = {name: getattr(case, name) for name in ("hand", "scene", "codec", "share", "channel")}
    return {**names, **figures}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seeds", type=record.within(1), default=2, help="how many orders of tissues and hands")
    parser.add_argument("--quick", action="store_true", help="one codec, one share, with and without delay")
    record.run(parser, measure, unit="as in each name; shares and fractions 0 to 1")


if __name__ == "__main__":
    main()
