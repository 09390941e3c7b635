"""What a recording costs a master at 1 kHz, how large it is, and how much of it is lost when a process is killed.

The cost is the processor time of the loop's process alone, with a recording and without, in turns; the writer is
another process, whose processor time is given beside it. What is lost is counted to the moment of ``kill -9``.
"""

import argparse
import asyncio
import os
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path
from subprocess import DEVNULL, Popen
from typing import Any

import numpy as np
import record

from hapticnet.node.master import MasterNode
from hapticnet.node.master_events import NodeEvent
from hapticnet.node.master_settings import MasterSettings
from hapticnet.node.recording import DATAGRAM_COLUMNS, Recording, master_columns
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.recordings.session.frames import Table
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.recovery import recover_file
from hapticnet.recordings.session.sink import UNFINISHED
from hapticnet.runtime.children import Child
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.master_run import run_master
from hapticnet.runtime.realtime import loop_factory, prefer_realtime
from hapticnet.runtime.recorder import Recorder
from hapticnet.runtime.session_recordings import MasterRecording
from hapticnet.runtime.udp import open_toward, parse_host_port
from hapticnet.runtime.watching import Watcher

FORMATS = (".mcap", ".csv", ".npz")
LIMIT = 2**31
FEWEST_BYTES = 8000
BATCH = 50
"""Ticks between two batches at 1 kHz."""


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    if arguments.kind is not None:
        return play(arguments)
    formats = FORMATS[:1] if arguments.quick else FORMATS
    names = ("off", *formats)
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    with tempfile.TemporaryDirectory() as folder:
        alone = {axes: [hand_over(Path(folder), axes) for _ in range(arguments.repetitions)] for axes in (1, 3)}
        for _ in range(arguments.repetitions):
            for name in names:
                runs[name].append(master(name, arguments.seconds, Path(folder)))
        lost = {
            victim: [kill(victim, suffix, Path(folder)) for suffix in formats for _ in range(arguments.kills)]
            for victim in ("node", "writer")
        }
    off = median(runs["off"], "own_us")
    return {
        "collecting a tick": {"1 axis": float(np.median(alone[1])), "3 axes": float(np.median(alone[3]))},
        "a tick of the master": {name: median(each, "own_us") for name, each in runs.items()},
        "recording adds": {name: median(runs[name], "own_us") - off for name in formats},
        "the writer, a tick": {name: median(runs[name], "writer_us") for name in formats},
        "lateness p99": {name: median(each, "p99_us") for name, each in runs.items()},
        "bytes a tick": {name: median(runs[name], "bytes") for name in formats},
        "lost by kill -9": {
            victim: {"median": float(np.median(each)), "max": max(each)} for victim, each in lost.items()
        },
    }


def median(runs: list[dict[str, Any]], key: str) -> float:
    return float(np.median([run[key] for run in runs]))


def hand_over(folder: Path, axes: int, ticks: int = 5000) -> float:
    """Return the processor time [µs] of adding a tick and its two datagrams, and of handing them over in batches."""
    path = folder / "alone.mcap"
    recorder = Recorder(print, limit_bytes=LIMIT)
    ticked, datagrams = Recording(master_columns(axes)), Recording(DATAGRAM_COLUMNS)
    tables = [Table.of("tick", ticked.columns), Table.of("datagram", datagrams.columns)]
    number = recorder.open(path, "master", tables, 0, {})
    row = (0.1,) * (len(ticked.columns) - 1)
    spent = 0
    for batch in range(ticks // BATCH):
        begun = time.thread_time_ns()
        for tick in range(batch * BATCH, (batch + 1) * BATCH):
            ticked.add((tick, *row))
            datagrams.add((tick, 1.0, 4.0, 26.0))
            datagrams.add((tick, 0.0, 5.0, 18.0))
        recorder.feed.rows(number, 0, ticked.take())
        recorder.feed.rows(number, 1, datagrams.take())
        recorder.feed.pump()
        spent += time.thread_time_ns() - begun
        time.sleep(0.003)
    recorder.finish()
    recorder.check()
    path.unlink()
    return spent / 1000 / ticks


def master(name: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Play a session in this process, record it as `name` says, and return what it cost."""
    slave = Child(["slave", "--listen", "127.0.0.1:0", "--scene", "paper:1"])
    path = folder / f"run{name}"
    try:
        sock, address = open_toward(parse_host_port(slave.address()))
        on = name != "off"
        settings = MasterSettings(record=on, record_datagrams=on)
        operator = ScriptedOperator(InsertionSettings(insertions=20), np.random.default_rng(1))
        node = MasterNode(operator, None, settings, SystemEntropy())
        meter = Meter(node)
        watchers: list[Watcher[NodeEvent]] = [meter]
        if on:
            watchers.append(MasterRecording(node, path, print, limit_bytes=LIMIT))
        others = children_s()
        with asyncio.Runner(loop_factory=loop_factory()) as runner:
            done = runner.run(run_master(node, sock, address, duration_s=seconds, watchers=watchers))
        writer_s = children_s() - others
    finally:
        slave.end()
    size = sum(file.stat().st_size for file in folder.glob("run*"))
    for file in folder.glob("run*"):
        file.unlink()
    return {
        "own_us": meter.us_a_tick(),
        "writer_us": 1e6 * writer_s / node.ticks,
        "bytes": size / node.ticks,
        "p99_us": done.lateness["p99_us"],
    }


class Meter(Watcher[NodeEvent]):
    """The processor time of this process, twice a second, after the first second: the start is not of interest."""

    def __init__(self, node: MasterNode) -> None:
        self.node = node
        self.marks: list[tuple[int, float]] = []

    def check(self, now_us: int) -> None:  # noqa: ARG002
        self.marks.append((self.node.ticks, time.process_time()))

    def us_a_tick(self) -> float:
        """Return the processor time of a tick [µs], the median over the half seconds."""
        spans = zip(self.marks[1:], self.marks[2:], strict=False)
        return float(np.median([1e6 * (after[1] - before[1]) / (after[0] - before[0]) for before, after in spans]))


def children_s() -> float:
    """Return the processor time of the children that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def kill(victim: str, suffix: str, folder: Path) -> float:
    """Kill a process that feeds a writer, or the writer, and return what is missing in its file [s]."""
    path = folder / f"killed{suffix}"
    arguments = ["--kind", "feed", "--file", str(path)]
    process = Popen([sys.executable, __file__, *arguments], stderr=DEVNULL, text=True, stdout=-1)
    assert process.stdout is not None
    writer = int(process.stdout.readline())
    unfinished = folder / f"{path.name}{UNFINISHED}"
    main_file = unfinished / "tick.rows" if suffix == ".npz" else unfinished
    while not main_file.exists() or main_file.stat().st_size < FEWEST_BYTES:
        time.sleep(0.01)
    time.sleep(0.5)
    killed_us = now_us()
    os.kill(process.pid if victim == "node" else writer, signal.SIGKILL)
    if victim == "node":
        process.wait()
        while not path.exists() or unfinished.exists():
            time.sleep(0.01)
    else:
        time.sleep(0.2)
        process.kill()
        process.wait()
        while Path(f"/proc/{writer}").exists():
            time.sleep(0.01)
        recover_file(unfinished, path)
    lost_s = (killed_us - int(read_session(path).main["t_us"][-1])) / 1e6
    for file in folder.glob("killed*"):
        file.unlink()
    return lost_s


def play(arguments: argparse.Namespace) -> dict[str, Any]:
    """Record at 1 kHz until killed; print the writer's process id first."""

    async def feed() -> None:
        operator = ScriptedOperator(InsertionSettings(), np.random.default_rng(1))
        settings = MasterSettings(record=True, record_datagrams=True)
        node = MasterNode(operator, None, settings, SystemEntropy())
        recording = MasterRecording(node, arguments.file, lambda _: None, limit_bytes=LIMIT)
        await recording.start()
        said = False
        while True:
            node.tick(now_us())
            node.drive(now_us())
            await asyncio.sleep(0.001)
            if recording.recorder.feed.pid is not None and not said:
                said = True
                print(recording.recorder.feed.pid, flush=True)

    asyncio.run(feed())
    return {}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(2.0), default=6.0, help="length of each session")
    parser.add_argument("--repetitions", type=record.within(1), default=3)
    parser.add_argument("--kills", type=record.within(1), default=5, help="processes killed of each kind and format")
    parser.add_argument("--quick", action="store_true", help="only .mcap")
    parser.add_argument("--no-real-time", action="store_true", help="leave everything in SCHED_OTHER")
    parser.add_argument("--kind", help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    if "--kind" not in sys.argv and "--no-real-time" not in sys.argv:
        prefer_realtime()
    record.run(parser, measure, unit="us of processor time; bytes; s lost")


if __name__ == "__main__":
    main()
