"""Whole sessions in virtual time: packets and bytes both ways, and what the hand feels, for every kind of coding.

Master and slave play the paper's scene over a channel with delay: handshake, positions, acknowledgements, forces,
keepalives and repair, as over UDP, with 28 B of UDP and IPv4 headers for every datagram. At each tick of the master the
force that is held is compared with the true force of the position at that tick. A force that answers at once is held
from the next tick on, so even without delay every setup is late by a tick of 1 ms.
"""

import argparse
import math
import statistics
from dataclasses import asdict
from typing import Any, Final

import numpy as np
import record

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.settings import BernoulliLoss, ChannelSettings, Jitter
from hapticnet.measure.energy import energy_report
from hapticnet.measure.metrics import error_report
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

Row = dict[str, Any]

SETUPS: Final[dict[str, dict[str, Any]]] = {
    "raw": {"codec": "raw"},
    "deadband (the paper)": {"codec": "deadband"},
    "linear-predictive": {"codec": "linear-predictive"},
    "adaptive-predictive": {"codec": "adaptive-predictive"},
    "motion-predictive": {"codec": "motion-predictive"},
    "deadband, coded positions": {"codec": "deadband", "positions": "line"},
    "motion-predictive, coded positions": {"codec": "motion-predictive", "positions": "line"},
    "deadband, predicted hand": {"codec": "deadband", "predicted": True},
    "motion-predictive, predicted hand": {"codec": "motion-predictive", "predicted": True},
    "predicted hand, coded positions": {"codec": "motion-predictive", "predicted": True, "positions": "line"},
    "announced scene": {"codec": "motion-predictive", "announced": True},
    "announced scene, coded positions": {"codec": "motion-predictive", "announced": True, "positions": "line"},
}
DELAYS_MS: Final = (0, 5, 25, 50)
LINKS: Final[dict[str, Row]] = {
    "clean": {},
    "loss of 5 %": {"loss": BernoulliLoss(0.05)},
    "jitter of 5 ms": {"jitter": Jitter(distribution="normal", deviation_us=5_000)},
}
"""What disturbs both directions beside the delay."""

HANDSHAKE_US: Final = 500_000
"""Traffic is counted after this time, while the hand still waits."""

TICKS_LATE: Final = 3
"""Ticks of a breach in addition to the round trip: to be stepped, answered and applied. `breach_share` is the share of
the squared error during that time."""

NOTHING: Final[Row] = {"packets": 0, "wire_bytes": 0, "by_kind": {}}


def measure(arguments: argparse.Namespace) -> Row:
    """Return a row for every setup, delay and loss: means over the hands."""
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    insertions, most_s = (1, 2.0) if arguments.quick else (arguments.insertions, math.inf)
    rows = []
    for name, setup in SETUPS.items():
        for delay_ms in DELAYS_MS:
            for link in LINKS:
                played = [play(setup, delay_ms, link, seed, insertions, most_s) for seed in seeds]
                means = {key: statistics.fmean(row[key] for row in played) for key in played[0]}
                rows.append({"setup": name, "delay_ms": delay_ms, "link": link} | means)
    return {"insertions": insertions, "rows": rows}


def play(setup: Row, delay_ms: int, link: str, seed: int, insertions: int, most_s: float) -> Row:
    """Play one session; return its traffic and what was felt."""
    hand = ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng([seed, 3]))
    assert hand.duration_us is not None
    channel = ChannelSettings(delay_us=1000 * delay_ms, **LINKS[link])
    to_slave, to_master, of_master, of_slave = np.random.default_rng([seed, 7]).spawn(4)
    session = Loopback(
        MasterNode(hand, None, MasterSettings(record=True, **setup), of_master),
        SlaveNode(lambda _: Scene(paper_scene(seed).tissues), SlaveSettings(), of_slave),
        forward=Emulator[bytes](channel, to_slave),
        feedback=Emulator[bytes](channel, to_master),
    )
    session.run(HANDSHAKE_US)
    begun = sent(session)
    seconds = min(hand.duration_us * 1e-6, most_s) - HANDSHAKE_US * 1e-6
    session.run(round(1e6 * seconds))
    ended = sent(session)
    assert session.master.recording is not None
    samples = session.master.recording.table()
    moves = samples["position_m"] != 0.0
    t_us, position_m = samples["t_us"][moves], samples["position_m"][moves]
    scene = Scene(paper_scene(seed).tissues)
    forces_n, late_until_us, late = [], -math.inf, []
    for t, at in zip(t_us.tolist(), position_m.tolist(), strict=True):
        breaches = scene.breaches
        forces_n.append(scene.step(PositionSample(round(t), (at,))).force_n)
        if scene.breaches > breaches:
            late_until_us = t + 2 * channel.delay_us + TICKS_LATE * 1000
        late.append(t <= late_until_us)
    true_n, held_n = np.array(forces_n), samples["held_n"][moves][:, None]
    squares = ((held_n - true_n) ** 2)[:, 0]
    law = WeberLaw()
    felt = error_report(law, true_n, held_n)
    return {
        **{key: (count - before) / seconds for (key, count), before in zip(ended.items(), begun.values(), strict=True)},
        **{f"felt_{name}": value for name, value in asdict(felt).items()},
        "breach_share": float(squares[late].sum() / (squares.sum() or 1.0)),
        "created_share": energy_report(law, true_n, held_n, position_m[:, None]).created_share,
    }


def sent(link: Loopback) -> dict[str, float]:
    """Return what both ends of the newest session have sent so far."""
    sessions = link.slave.report()["sessions"]
    forward, feedback = link.master.report()["sent"], sessions[-1]["sent"] if sessions else NOTHING
    return {
        "forward_packets_per_s": forward["packets"],
        "forward_bytes_per_s": forward["wire_bytes"],
        "feedback_packets_per_s": feedback["packets"],
        "feedback_bytes_per_s": feedback["wire_bytes"],
        "keepalives_per_s": feedback["by_kind"].get("keepalive", 0),
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seeds", type=record.within(1), default=3, help="how many hands and orders of tissues")
    parser.add_argument("--insertions", type=record.within(1), default=2, help="insertions of each hand")
    parser.add_argument("--quick", action="store_true", help="the first two seconds of an insertion")
    record.run(parser, measure, unit="as in each name; shares 0 to 1")


if __name__ == "__main__":
    main()
