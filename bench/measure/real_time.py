"""How late the ticks of the 1 kHz loop are, and how long a position takes to come back as a force.

Each is measured beside its limit in the same run, in turns, with the same scheduling: the master's ticks beside a C
program that sleeps with clock_nanosleep, position to force beside a bare UDP echo between two uvloop processes.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import record

from hapticnet.runtime.children import Child

PEERS = Path(__file__).parents[1] / "peers"
PERCENTILES = (50, 99, 99.9)
CODECS = ("raw", "deadband")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    fifo = not arguments.no_realtime and fifo_is_granted()
    runs: dict[str, list[Any]] = {"c_tick": [], "udp_echo": [], **{codec: [] for codec in CODECS}}
    with tempfile.TemporaryDirectory() as folder:
        tick = compile_c(Path(folder))
        for _ in range(arguments.repetitions):
            runs["c_tick"].append(c_tick(tick, arguments.seconds, fifo))
            runs["udp_echo"].append(udp_echo(arguments.seconds, fifo))
            for codec in CODECS:
                runs[codec].append(hapticnet(codec, arguments.seconds, fifo, Path(folder)))
    return {"scheduling": "SCHED_FIFO" if fifo else "SCHED_OTHER", **summary(runs)}


def fifo_is_granted() -> bool:
    """Tell whether this user may use SCHED_FIFO; asked in a separate process."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))"
    return subprocess.run([sys.executable, "-c", code], stderr=subprocess.DEVNULL, check=False).returncode == 0


def compile_c(folder: Path) -> Path:
    subprocess.run(["gcc", "-O2", "-o", folder / "tick", PEERS / "tick.c"], check=True)
    return folder / "tick"


def c_tick(program: Path, seconds: float, fifo: bool) -> list[float]:
    done = subprocess.run(
        [program, str(round(1000 * seconds)), "10" if fifo else "0"], capture_output=True, text=True, check=True
    )
    return [float(line) for line in done.stdout.split()]


def udp_echo(seconds: float, fifo: bool) -> list[float]:
    command = [sys.executable, str(PEERS / "udp_echo.py"), *(["--realtime"] if fifo else [])]
    environment = os.environ | {"PYTHONPATH": str(PEERS.parents[1])}
    server = subprocess.Popen([*command, "server"], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert server.stdout is not None
        port = server.stdout.readline().strip()
        client = subprocess.run(
            [*command, "client", port, str(seconds)], capture_output=True, text=True, check=True, env=environment
        )
        return [float(line) for line in client.stdout.split()]
    finally:
        server.terminate()
        server.communicate()


def hapticnet(codec: str, seconds: float, fifo: bool, folder: Path) -> dict[str, Any]:
    """Run a slave and a master process and return the master's report."""
    scheduling = "--realtime" if fifo else "--no-realtime"
    report = folder / "master.json"
    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "paper:1", scheduling])
    try:
        arguments = ["master", "--connect", slave.address(), "--codec", codec, "--duration", str(seconds), scheduling]
        Child([*arguments, "--connect-timeout", "10", "--report", str(report), "--quiet"]).finish()
    finally:
        slave.end()
    account: dict[str, Any] = json.loads(report.read_text())
    return account


def summary(runs: dict[str, list[Any]]) -> dict[str, Any]:
    """Return percentiles as medians over the repetitions."""
    limits = {
        name: [float(np.median([np.percentile(run, percent) for run in runs[name]])) for percent in PERCENTILES]
        for name in ("c_tick", "udp_echo")
    }
    results: dict[str, Any] = {
        "tick lateness": {"C clock_nanosleep": limits["c_tick"]},
        "position to force": {"bare UDP echo": limits["udp_echo"]},
    }
    for codec in CODECS:
        for measure, key in (("tick lateness", "lateness"), ("position to force", "round_trip")):
            results[measure][f"hapticnet, {codec}"] = [
                float(np.median([run[key][name] for run in runs[codec]])) for name in ("p50_us", "p99_us", "p99_9_us")
            ]
    results["missed ticks"] = {codec: [run["missed_ticks"] for run in runs[codec]] for codec in CODECS}
    return results


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.1), default=8.0, help="length of each measurement")
    parser.add_argument("--repetitions", type=record.within(1), default=3)
    parser.add_argument("--no-realtime", action="store_true", help="leave everything in SCHED_OTHER")
    record.run(parser, measure, unit="us")


if __name__ == "__main__":
    main()
