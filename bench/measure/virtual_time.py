"""How many times faster than real time both nodes run in virtual time, with every packet built and parsed."""

import argparse
import os
import statistics
import time

import numpy as np
import record

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.scene.sources import paper_scene

CASES = {
    "no device": ("perfect", False),
    "simulated device": ("perfect", True),
    "simulated device, wifi": ("wifi", True),
    "simulated device, 4g": ("4g", True),
}
"""Channel of both directions, and whether there is a device. Always the paper's scene, 1 kHz and 1 JND."""


def both_nodes(
    seed: int,
    operator: ScriptedOperator,
    settings: MasterSettings,
    *,
    channel: str = "perfect",
    device: bool = False,
    start_us: int = 0,
    tissues: tuple[Tissue, ...] | None = None,
) -> Loopback:
    """Return a slave with the paper's scene, or other tissues, and a master, joined by two channels of one kind."""
    scene = paper_scene(seed)
    forward, feedback, plant, nonces, sessions = np.random.default_rng(seed).spawn(5)
    return Loopback(
        MasterNode(operator, SimulatedDevice(PlantSettings(), plant) if device else None, settings, nonces),
        SlaveNode(
            lambda _: Scene(tissues or scene.tissues, name=scene.name),
            SlaveSettings(record=settings.record, session=settings.session),
            sessions,
        ),
        forward=Emulator(parse_channel(channel), forward),
        feedback=Emulator(parse_channel(channel), feedback),
        start_us=start_us,
    )


def run(case: str, seed: int, insertions: int) -> dict[str, float]:
    """Play the insertions once; return their virtual duration and the time it took."""
    channel, device = CASES[case]
    operator = ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng(seed))
    loopback = both_nodes(seed, operator, MasterSettings(), channel=channel, device=device)
    started_s = time.perf_counter()
    loopback.run(operator.duration_us)
    taken_s = time.perf_counter() - started_s
    (context,) = loopback.slave.contexts
    return {"virtual_s": operator.duration_us / 1e6, "taken_s": taken_s, "steps": context.steps}


def summary(runs: list[dict[str, float]]) -> dict[str, float]:
    """Return best and median over the repetitions of one case; all do the same work."""
    (virtual_s,) = {each["virtual_s"] for each in runs}
    (steps,) = {each["steps"] for each in runs}
    times_real_time = [virtual_s / each["taken_s"] for each in runs]
    return {
        "virtual_s": virtual_s,
        "positions_answered": steps,
        "times_real_time_best": max(times_real_time),
        "times_real_time_median": statistics.median(times_real_time),
        "us_per_virtual_ms_best": 1000.0 / max(times_real_time),
    }


def measure(arguments: argparse.Namespace) -> dict[str, object]:
    """Measure the cases in turns and return all results."""
    runs: dict[str, list[dict[str, float]]] = {case: [] for case in CASES}
    for _ in range(arguments.repetitions):
        for case, measured in runs.items():
            measured.append(run(case, arguments.seed, arguments.insertions))
    return {"load_average": os.getloadavg()[0], "cases": {case: summary(measured) for case, measured in runs.items()}}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--insertions", type=record.within(1), default=5, help="insertions per run")
    parser.add_argument("--repetitions", type=record.within(1), default=7)
    record.run(parser, measure, unit="as in each name; times_real_time is virtual time over wall-clock time")


if __name__ == "__main__":
    main()
