"""Where the time of one round trip goes: two processes with clocks around each step, beside a bare UDP echo.

Master and slave run as in real use: the caches are as cold as the pauses between two positions leave them. The codec is
"raw", so that every position is answered.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import real_time
import record

from hapticnet.arrays import IntArray
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.runtime.runners import run_master, run_slave
from hapticnet.runtime.system import SystemEntropy, prefer_realtime, run
from hapticnet.runtime.udp import HostPort, bound_address, host_of, listen, open_toward
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

SETTLED_S = 0.5
"""Time after the first position that is not measured."""

STEPS = (
    "master: position and datagram",
    "master sends, kernel, slave wakes and reads",
    "slave: force and datagram",
    "slave sends, kernel, master wakes and reads",
)
BESIDE = ("master: holds the force", "master: takes the force in", "slave: accounts for the answer")


def stamped(function: Callable[..., Any], stamps: "array[int]") -> Callable[..., Any]:
    """Return a function that notes when it is called and when it returns [ns]."""
    clock = time.monotonic_ns

    def call(*given: Any) -> Any:
        start_ns = clock()
        result = function(*given)
        stamps.append(start_ns)
        stamps.append(clock())
        return result

    return call


class Clocked:
    """A node with clocks around some of its methods. Their stamps grow: before and after each call [ns]."""

    def __init__(self, node: Any, *names: str) -> None:
        self._node = node
        self.stamps: dict[str, array[int]] = {name: array("q") for name in names}
        for name, stamps in self.stamps.items():
            setattr(self, name, stamped(getattr(node, name), stamps))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)


def slave(folder: Path, *, fifo: bool) -> None:
    """Serve until terminated, and write the stamps."""
    scene = paper_scene(1)
    node: Any = Clocked(
        SlaveNode(lambda _: Scene(scene.tissues, name=scene.name), SlaveSettings(), SystemEntropy(), host_of=host_of),
        "receive_datagrams",
        "account_sent",
    )
    sock = listen(HostPort("127.0.0.1", 0))
    if fifo:
        prefer_realtime()
    run(run_slave(node, sock, on_listening=lambda: print(bound_address(sock), flush=True)))
    np.savez(folder / "slave.npz", **node.stamps)  # type: ignore[arg-type]


def master(folder: Path, address: str, seconds: float, *, fifo: bool) -> None:
    """Move for `seconds` [s], and write the stamps."""
    operator = ScriptedOperator(InsertionSettings(insertions=5), np.random.default_rng(1))
    master_node = MasterNode(operator, None, MasterSettings(codec="raw"), SystemEntropy())
    node: Any = Clocked(master_node, "tick", "receive_datagram", "drive")
    host, _, port = address.rpartition(":")
    sock, target = open_toward(HostPort(host, int(port)))
    if fifo:
        prefer_realtime()
    run(run_master(node, sock, target, duration_s=seconds, connect_timeout_s=10.0))
    np.savez(folder / "master.npz", **node.stamps)  # type: ignore[arg-type]


def one_run(seconds: float, *, fifo: bool) -> dict[str, float]:
    """Return the medians [µs] of one run."""
    options = ["--real-time"] * fifo
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--folder", folder, *options]
        server = subprocess.Popen([*command, "--end", "slave"], stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            address = server.stdout.readline().strip()
            subprocess.run([*command, "--end", address, "--seconds", str(seconds)], check=True)
        finally:
            server.terminate()
            server.communicate()
        with np.load(Path(folder) / "slave.npz") as slaves, np.load(Path(folder) / "master.npz") as masters:
            return medians({**slaves, **masters})


def medians(stamps: dict[str, IntArray]) -> dict[str, float]:
    """Return the medians [µs] of the steps of the completely recorded round trips."""
    calls = {name: values.reshape(-1, 2) for name, values in stamps.items()}
    ticks = calls["tick"]
    ticks = ticks[ticks[:, 0] > ticks[0, 0] + SETTLED_S * 1e9][:-1]
    served, received = calls["receive_datagrams"], calls["receive_datagram"]
    at = np.searchsorted(served[:, 0], ticks[:, 1]).clip(max=len(served) - 1)
    back = np.searchsorted(received[:, 0], served[at, 1]).clip(max=len(received) - 1)
    trips = np.column_stack([ticks, served[at], received[back]])
    ordered = np.all(np.diff(trips[:, :5], axis=1) > 0, axis=1)
    trips = trips[ordered & (trips[:, 4] - trips[:, 0] < 900_000)]  # otherwise it may answer another position
    steps = np.median(np.diff(trips[:, :5], axis=1), axis=0) / 1e3
    beside = [np.median(np.diff(calls[name], axis=1)) / 1e3 for name in ("drive", "receive_datagram", "account_sent")]
    return {
        **dict(zip(STEPS, steps.tolist(), strict=True)),
        "round trip": float(np.median(trips[:, 4] - trips[:, 0]) / 1e3),
        **dict(zip(BESIDE, map(float, beside), strict=True)),
    }


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the steps, and the echo's round trip, in turns."""
    fifo = not arguments.no_real_time and real_time.fifo_is_granted()
    runs: list[dict[str, float]] = []
    echoes: list[float] = []
    for _ in range(arguments.repetitions):
        echoes.append(statistics.median(real_time.udp_echo(arguments.seconds, fifo)))
        runs.append(one_run(arguments.seconds, fifo=fifo))
    return {
        "scheduling": "SCHED_FIFO" if fifo else "SCHED_OTHER",
        "bare UDP echo": statistics.median(echoes),
        "steps": {step: statistics.median(each[step] for each in runs) for step in runs[0]},
        "times the echo": statistics.median(each["round trip"] / echo for each, echo in zip(runs, echoes, strict=True)),
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(1.0), default=4.0, help="length of each measurement")
    parser.add_argument("--repetitions", type=record.within(1), default=3)
    parser.add_argument("--no-real-time", action="store_true", help="leave everything in SCHED_OTHER")
    if "--end" not in sys.argv:
        record.run(parser, measure, unit="µs, medians")
        return
    end = argparse.ArgumentParser()
    end.add_argument("--end", required=True)
    end.add_argument("--folder", type=Path, required=True)
    end.add_argument("--seconds", type=float, default=4.0)
    end.add_argument("--real-time", action="store_true")
    chosen = end.parse_args()
    if chosen.end == "slave":
        slave(chosen.folder, fifo=chosen.real_time)
    else:
        master(chosen.folder, chosen.end, chosen.seconds, fifo=chosen.real_time)


if __name__ == "__main__":
    main()
