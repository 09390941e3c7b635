"""Run a benchmark: its options, and its results as JSON with the code, machine, seed and repetitions they hold for."""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hapticnet.compiled import describe_core
from hapticnet.errors import HapticnetError
from hapticnet.experiment.provenance import provenance


def options(description: str | None, *, seed: int = 1) -> argparse.ArgumentParser:
    """Return a parser with the options that every benchmark has; the first line of `description` is its help."""
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to FILE instead of the terminal")
    parser.add_argument("--seed", type=within(0), default=seed, help="seed, or the first of several")
    return parser


def within(least: float, most: float = 1e9) -> Callable[[str], float]:
    """Return a parser of numbers in a range; whole numbers if `least` is an int."""

    def number(text: str) -> float:
        if not least <= (value := type(least)(text)) <= most:
            raise argparse.ArgumentTypeError(f"{text} must be from {least:g} to {most:g}")
        return value

    return number


def run(parser: argparse.ArgumentParser, measure: Callable[[argparse.Namespace], Any], *, unit: str) -> None:
    """Write what `measure` returns for the arguments, all in `unit`, to the file of ``--json`` or to the terminal.

    The arguments have ``repetitions`` or ``seeds``. An error of hapticnet ends in one line.
    """
    arguments = parser.parse_args()
    began_s, others_s = time.monotonic(), cpu_of_others_s()
    try:
        results = measure(arguments)
    except HapticnetError as error:
        parser.error(str(error))
    record = {
        "name": Path(sys.argv[0]).stem,
        "revision": describe_revision(),
        "core": describe_core(),
        "seed": arguments.seed,
        "unit": unit,
        "repetitions": arguments.repetitions if hasattr(arguments, "repetitions") else arguments.seeds,
        "cores_of_others": (cpu_of_others_s() - others_s) / (time.monotonic() - began_s),
        **provenance(),
        "results": results,
    }
    text = json.dumps(record, indent=2)
    if arguments.json is None:
        print(text)
        return
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(text + "\n", encoding="utf-8")
    print(f"wrote {arguments.json}")


def cpu_of_others_s() -> float:
    """Return the processor time [s] of this machine since it started, without that of this benchmark.

    A child's time counts as that of other programs until the child has been waited for.
    """
    fields = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()[1:9]
    user, nice, system, _idle, _waiting, irq, softirq, _stolen = map(int, fields)
    own = os.times()
    busy_s = (user + nice + system + irq + softirq) / os.sysconf("SC_CLK_TCK")
    return busy_s - own.user - own.system - own.children_user - own.children_system


def describe_revision() -> str:
    """Return git's description of this revision; "unknown" outside a repository."""
    command = ["git", "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()
