"""What communities use for forces over a network, beside hapticnet: the same hand, scenes, machine and links, in turns.

A loop of LeRobot's remote robot, topics of ROS 2, a JSON WebSocket, and sessions of hapticnet. The processes and links
are those of ``peers.py``. In each turn all doors are measured one after the other, and ratios are to hapticnet's raw
session of the same turn and link, because the speed of a machine changes.
"""

import argparse
import os
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import record
from peer_ends import PAPER
from peer_link import link
from peer_run import Runner
from real_time import fifo_is_granted
from stacks import DOORS

from hapticnet.errors import UnavailableError
from peers import FIFO_PRIORITY, attempt, say, summary

BASE: Final = "hapticnet, raw"
PREDICTIVE: Final[dict[str, Any]] = {"codec": "motion-predictive"}
SESSIONS: Final[dict[str, dict[str, Any]]] = {
    BASE: {"codec": "raw"},
    "hapticnet, deadband": {"codec": "deadband"},
    "hapticnet, motion-predictive": PREDICTIVE,
    "hapticnet, motion-predictive, energy-bounded": PREDICTIVE | {"coupling": "energy-bounded"},
    "hapticnet, motion-predictive, predicted": PREDICTIVE | {"predicted": True},
    "hapticnet, motion-predictive, predicted, few positions": PREDICTIVE | {"predicted": True, "positions": "line"},
}
"""Open sessions, by what their master asks for."""

MOTION: Final = {
    "approach_m": 0.018,
    "depth_m": 0.034,
    "approach_s": 0.3,
    "push_s": 1.0,
    "push_steps": 2,
    "pause_s": 0.1,
    "withdraw_s": 0.5,
    "rest_s": 0.2,
}
"""One insertion in 2.3 s, as fast as the default one, which breaches the first tissue of the paper's scene."""

TISSUE: Final = """
name = "tissue"

[[tissue]]
name = "tissue"
rest_position_m = 0.020
stiffness_n_per_m = 250.0
breach_force_n = 100.0
"""
LINKS: Final = {"clean": (None, 0.0), "25 ms each way, 2 % loss": (25.0, 0.02)}
COMPARED: Final = ("p50_us", "bytes", "packets", "cpu_us")


def scenes(folder: Path, *, quick: bool) -> dict[str, str]:
    """Return each scene's name and its value for ``--scene``."""
    (folder / "tissue.toml").write_text(TISSUE)
    paper = {"the paper's scene": PAPER}
    return paper if quick else {"one tissue": str(folder / "tissue.toml")} | paper


def cases(only: list[str] | None) -> dict[str, dict[str, Any] | None]:
    """Return the settings of every door that can be measured here, None for one of another community."""
    found: dict[str, dict[str, Any] | None] = {}
    for name, stack in DOORS.items():
        if stack.missing is not None:
            say(f"left out: {name} ({stack.missing} is missing; make bench installs everything)")
        else:
            found[name] = None
    found |= {name: settings | {"sealed": False} for name, settings in SESSIONS.items()}
    unknown = [name for name in only or () if name not in found]
    if unknown:
        raise UnavailableError(f"no such door here: {', '.join(unknown)}; there are: {'; '.join(found)}")
    return {name: settings for name, settings in found.items() if name in (only or found) or name == BASE}


def turn(runner: Runner, link_name: str, seed: int, only: list[str] | None) -> dict[str, dict[str, Any]]:
    """Return the figures of each door over a link, with ratios to the raw session."""
    delay_ms, loss = LINKS[link_name]
    with link(delay_ms, loss, seed) as wire:
        runs = {name: attempt(runner, wire, name, settings) for name, settings in cases(only).items()}
    base = runs[BASE]
    worked = {name: run for name, run in runs.items() if run is not None}
    for run in worked.values():
        for key in COMPARED:
            run[f"{key}_ratio"] = None if base is None or run[key] is None else run[key] / base[key]
    return worked


def row(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the medians of a door over the turns, and the smallest and largest share of ticks that are not right."""
    wrong = [run["wrong"] for run in runs]
    return summary(name, runs) | ({"wrong_least": min(wrong), "wrong_most": max(wrong)} if runs else {})


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    if os.geteuid():
        raise UnavailableError("network namespaces and the lossy link need root: run this with sudo, or as root")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # unwind, which ends processes and namespaces
    fifo = not arguments.no_real_time and fifo_is_granted()
    if fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIFO_PRIORITY))
    before = os.getloadavg()[0]
    found: dict[tuple[str, str], dict[str, list[dict[str, Any]]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(arguments.repetitions):
            for scene, source in scenes(Path(folder), quick=arguments.quick).items():
                seed = arguments.seed + number
                ticks = round(1000 * arguments.seconds)
                runner = Runner(Path(folder), [], ticks=ticks, seed=seed, fifo=fifo, scene=source, motion=MOTION)
                for link_name in LINKS:
                    runs = found.setdefault((link_name, scene), {name: [] for name in cases(arguments.only)})
                    for name, run in turn(runner, link_name, seed, arguments.only).items():
                        runs[name].append(run)
            say(f"turn {number + 1} of {arguments.repetitions}: load average {os.getloadavg()[0]:.1f}")
    places = [
        {"link": link_name, "scene": scene, "rows": [row(name, runs) for name, runs in doors.items()]}
        for (link_name, scene), doors in found.items()
    ]
    return {
        "scheduling": "SCHED_FIFO" if fifo else "SCHED_OTHER",
        "seconds": arguments.seconds,
        "load_before": before,
        "load_after": os.getloadavg()[0],
        "places": sorted(places, key=lambda each: list(LINKS).index(str(each["link"]))),
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.1), default=2.3, help="length of each measurement")
    parser.add_argument("--repetitions", type=record.within(1), default=2, help="turns")
    parser.add_argument("--quick", action="store_true", help="only the paper's scene")
    parser.add_argument("--only", nargs="+", metavar="DOOR", help=f"only these, by name, beside {BASE}")
    parser.add_argument("--no-real-time", action="store_true", help="leave everything in SCHED_OTHER")
    record.run(parser, measure, unit="as in each name; bytes, packets and CPU time for each position of the hand")


if __name__ == "__main__":
    main()
