"""How late the ticks of the 1 kHz loop are, and how long a position takes to come back as a force.

Each is measured beside its limit in the same run, in turns, with the same scheduling: the master's ticks beside a C
program that sleeps with clock_nanosleep, position to force beside a bare UDP echo between two uvloop processes. Each
codec runs in open and in sealed sessions.
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

from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import MasterEntry, format_key, new_key
from hapticnet.runtime.processes import Child
from hapticnet.runtime.system import SystemEntropy

PEERS = Path(__file__).parents[1] / "peers"
PERCENTILES = (50, 99, 99.9)
CODECS = ("raw", "deadband")
CASES = tuple((codec, sealed) for codec in CODECS for sealed in (False, True))


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    fifo = not arguments.no_real_time and fifo_is_granted()
    runs: dict[str, list[Any]] = {"c_tick": [], "udp_echo": [], **{name(*case): [] for case in CASES}}
    with tempfile.TemporaryDirectory() as folder:
        tick = compile_c(Path(folder))
        keys = write_keys(Path(folder))
        for _ in range(arguments.repetitions):
            runs["c_tick"].append(c_tick(tick, arguments.seconds, fifo))
            runs["udp_echo"].append(udp_echo(arguments.seconds, fifo))
            for codec, sealed in CASES:
                report = hapticnet(codec, arguments.seconds, fifo, Path(folder), keys if sealed else ([], []))
                assert report["sealed"] is sealed
                runs[name(codec, sealed)].append(report)
    return {"scheduling": "SCHED_FIFO" if fifo else "SCHED_OTHER", **summary(runs)}


def name(codec: str, sealed: bool) -> str:
    return f"{codec}, sealed" if sealed else codec


def write_keys(folder: Path) -> tuple[list[str], list[str]]:
    """Write the files of a sealed session; return the options for the slave and for the master."""
    slave, master = new_key(SystemEntropy()), new_key(SystemEntropy())
    write_key(folder / "slave.toml", slave)
    write_key(folder / "master.toml", master)
    (folder / "masters.toml").write_text(dump_master(MasterEntry(name="bench", public=master.public)))
    return (
        ["--key", str(folder / "slave.toml"), "--masters", str(folder / "masters.toml")],
        ["--key", str(folder / "master.toml"), "--peer-key", format_key(slave.public)],
    )


def fifo_is_granted() -> bool:
    """Return whether this user may use SCHED_FIFO, tested in a separate process."""
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
    command = [sys.executable, str(PEERS / "udp_echo.py"), *(["--real-time"] if fifo else [])]
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


def hapticnet(
    codec: str, seconds: float, fifo: bool, folder: Path, keys: tuple[list[str], list[str]]
) -> dict[str, Any]:
    """Run a slave and a master process with the options of `keys`, and return the master's report."""
    scheduling = "--real-time" if fifo else "--no-real-time"
    report = folder / "master.json"
    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "paper:1", scheduling, *keys[0]])
    try:
        arguments = ["master", "--connect", slave.address(), "--codec", codec, "--duration", str(seconds), scheduling]
        arguments += keys[1]
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
    cases = [name(*case) for case in CASES]
    for case in cases:
        for measure, key in (("tick lateness", "lateness"), ("position to force", "round_trip")):
            results[measure][f"hapticnet, {case}"] = [
                float(np.median([run[key][percent] for run in runs[case]]))
                for percent in ("p50_us", "p99_us", "p99_9_us")
            ]
    results["missed ticks"] = {case: [run["missed_ticks"] for run in runs[case]] for case in cases}
    results["sealed over open"] = {
        codec: float(np.median([b["round_trip"]["p50_us"] / a["round_trip"]["p50_us"] for a, b in pairs(runs, codec)]))
        for codec in CODECS
    }
    results["bytes a datagram"] = {
        case: [float(np.median([mean_bytes(run[way]) for run in runs[case]])) for way in ("sent", "received")]
        for case in cases
    }
    return results


def pairs(runs: dict[str, list[Any]], codec: str) -> list[tuple[Any, Any]]:
    """Return the reports of each repetition, of the open and of the sealed session."""
    return list(zip(runs[name(codec, False)], runs[name(codec, True)], strict=True))


def mean_bytes(way: dict[str, Any]) -> float:
    """Return the mean UDP payload [B] of a direction's datagrams."""
    return float(way["payload_bytes"] / way["packets"])


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.1), default=8.0, help="length of each measurement")
    parser.add_argument("--repetitions", type=record.within(1), default=3)
    parser.add_argument("--no-real-time", action="store_true", help="leave everything in SCHED_OTHER")
    record.run(parser, measure, unit="us")


if __name__ == "__main__":
    main()
