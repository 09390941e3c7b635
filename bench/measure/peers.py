"""The same work over other stacks: positions a thousand times a second one way, forces back the other.

Each stack has two processes in two network namespaces with their own link. Quiet, the link is a veth pair, and a
bare UDP echo runs before and after each measurement. Lossy, a process delays each IP packet and drops some, the same
way for all. A stack whose packages are missing is left out, with a line.
"""

import argparse
import itertools
import os
import signal
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import record
from flood_roles import MASTER_KEY, SLAVE_KEY
from peer_felt import ages
from peer_link import Link, link
from peer_run import Runner, StackError
from real_time import fifo_is_granted
from stacks import STACKS

from hapticnet.errors import UnavailableError
from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import MasterEntry

LIMIT: Final = "UDP"
DELAY_MS: Final = 20.0
"""Each way, on the lossy link."""

LOSSES: Final = (0.0, 0.01, 0.05)
MASTERS: Final[dict[str, dict[str, Any]]] = {
    "hapticnet, raw": {"codec": "raw"},
    "hapticnet, deadband": {"codec": "deadband"},
    "hapticnet, few positions": {"codec": "motion-predictive", "positions": "line"},
    "hapticnet, motion-predictive": {"codec": "motion-predictive"},
    "hapticnet, announced": {"codec": "motion-predictive", "positions": "line", "announced": True},
}
"""Settings that a master of hapticnet asks for. The first three are measured sealed too."""

QUICK: Final = ("UDP", "TCP", "hapticnet, raw", "hapticnet, few positions, sealed")
FIFO_PRIORITY: Final = 12
"""Priority of this process, above the measured ones, so that counters are read in time."""

Cases = dict[str, dict[str, Any] | None]


def cases() -> Cases:
    """Return the settings of every case, None for a peer."""
    found: Cases = dict.fromkeys(STACKS)
    for number, (name, settings) in enumerate(MASTERS.items()):
        found[name] = {**settings, "sealed": False}
        if number < 3:
            found[f"{name}, sealed"] = {**settings, "sealed": True}
    return found


def here(arguments: argparse.Namespace) -> Cases:
    """Return the cases that can run here; say which cannot."""
    found = cases()
    for name, stack in STACKS.items():
        if stack.missing is not None:
            say(f"left out: {name} ({stack.missing} is missing; make bench installs everything)")
            del found[name]
    wanted = QUICK if arguments.quick else arguments.only or tuple(found)
    unknown = [name for name in wanted if name not in found]
    if unknown:
        raise UnavailableError(f"no such stack here: {', '.join(unknown)}; there are: {'; '.join(found)}")
    return {name: settings for name, settings in found.items() if name in wanted}


def quiet(runner: Runner, found: Cases, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure every case between two echoes, in turns."""
    runs: dict[str, list[dict[str, Any]]] = {LIMIT: [], **{name: [] for name in found}}
    for turn in range(arguments.repetitions):
        with link(None, 0.0, arguments.seed) as wire:
            before = attempt(runner, wire, LIMIT, None)
            for name, settings in found.items():
                if name == LIMIT:
                    continue
                run, after = attempt(runner, wire, name, settings), attempt(runner, wire, LIMIT, None)
                if run is not None and before is not None and after is not None:
                    for key in ("p50", "p99"):
                        limit_us = (before[f"{key}_us"] + after[f"{key}_us"]) / 2.0
                        run[f"{key}_ratio"] = run[f"{key}_us"] / limit_us if run[f"{key}_us"] else None
                    runs[name].append(run)
                if before is not None:
                    runs[LIMIT].append({**before, "p50_ratio": 1.0, "p99_ratio": 1.0})
                before = after
        say(f"quiet, turn {turn + 1} of {arguments.repetitions}: load average {os.getloadavg()[0]:.1f}")
    return [summary(name, several) for name, several in runs.items()]


def lossy(runner: Runner, found: Cases, loss: float, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure every case over the link that delays and drops, in turns."""
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in found}
    turns = max(1, arguments.repetitions - 1)
    for turn in range(turns):
        with link(DELAY_MS, loss, arguments.seed + turn) as wire:
            for name, settings in found.items():
                if (run := attempt(runner, wire, name, settings)) is not None:
                    runs[name].append(run)
        say(f"loss {loss:.0%}, turn {turn + 1} of {turns}: load average {os.getloadavg()[0]:.1f}")
    return [summary(name, several) for name, several in runs.items()]


def attempt(runner: Runner, wire: Link, name: str, settings: dict[str, Any] | None) -> dict[str, Any] | None:
    """Run a case, once more if it fails; None if it fails again."""
    for _ in range(2):
        try:
            run = runner.run(wire, name, settings)
        except StackError as error:
            say(f"{name}: {error}")
        else:
            return run | ages(run.pop("seen"), runner.scene)
    return None


def summary(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the medians over the turns; only ``runs``, 0, if the case never worked."""
    row: dict[str, Any] = {"stack": name, "runs": len(runs)}
    for key in dict.fromkeys(itertools.chain.from_iterable(runs)):
        values = [run[key] for run in runs if run[key] is not None]
        row[key] = statistics.median(values) if values else None
    return row


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    if os.geteuid():
        raise UnavailableError("network namespaces and the lossy link need root: run this with sudo, or as root")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # unwind, which ends processes and namespaces
    fifo = not arguments.no_real_time and fifo_is_granted()
    if fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIFO_PRIORITY))
    with tempfile.TemporaryDirectory() as folder:
        keys = write_keys(Path(folder))
        runner = Runner(Path(folder), keys, ticks=round(1000 * arguments.seconds), seed=arguments.seed, fifo=fifo)
        found = here(arguments)
        results: dict[str, Any] = {
            "scheduling": "SCHED_FIFO" if fifo else "SCHED_OTHER",
            "seconds": arguments.seconds,
            "delay_ms": DELAY_MS,
            "load_before": os.getloadavg()[0],
            "quiet": quiet(runner, found, arguments),
        }
        losses = LOSSES[-1:] if arguments.quick else LOSSES
        results["lossy"] = [{"loss": loss, "rows": lossy(runner, found, loss, arguments)} for loss in losses]
    results["load_after"] = os.getloadavg()[0]
    return results


def write_keys(folder: Path) -> list[str]:
    """Write the slave's key and its list of masters; return the options that name them."""
    write_key(folder / "slave.toml", SLAVE_KEY)
    (folder / "masters.toml").write_text(dump_master(MasterEntry(name="bench", public=MASTER_KEY.public)))
    return ["--key", str(folder / "slave.toml"), "--masters", str(folder / "masters.toml")]


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.1), default=4.0, help="length of each measurement")
    parser.add_argument(
        "--repetitions", type=record.within(1), default=3, help="turns; one less over the lossy link, at least one"
    )
    parser.add_argument("--quick", action="store_true", help=f"only {'; '.join(QUICK)}, quiet and with the most loss")
    parser.add_argument("--only", nargs="+", metavar="STACK", help="only these, by name")
    parser.add_argument("--no-real-time", action="store_true", help="leave everything in SCHED_OTHER")
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
