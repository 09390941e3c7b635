"""Processes of `sessions`: a slave or an echo on one CPU, the load generator on another, and the result of a run.

Processor time is the scheduler's own account of the server's threads (schedstat), between the moments at which the
generator begins and ends to count. It includes system calls and the path of sent datagrams through the kernel to the
receiver's socket; the path of positions counts for the generator likewise, for the echo as for the slave.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import MasterEntry, new_key
from hapticnet.runtime.system import FIFO_PRIORITY, SystemEntropy

PEERS: Final = Path(__file__).parents[1] / "peers"
START_WITHIN_S: Final = 60.0
END_WITHIN_S: Final = 20.0
MOST_SESSIONS: Final = 60_000
CPUS: Final = sorted(os.sched_getaffinity(0))
SERVER_CPUS: Final = set(CPUS[:1])
GENERATOR_CPUS: Final = set(CPUS[1:2] or CPUS)


class Case(NamedTuple):
    """What each master requests and sends.

    Attributes
    ----------
    sends_hz
        Datagrams a second of each master.
    share
        Share of the JND that is left to positions; 0 if every position is sent.
    one_in
        The echo answers one in this many datagrams, about as few as the slave.
    masters
        Number of masters while the processor time of all servers is compared.
    """

    codec: str
    rate_hz: float
    sends_hz: float
    sealed: bool
    share: float
    one_in: int
    masters: int


@dataclass(frozen=True)
class Bench:
    """What all runs share: the compiled programs, keys, scheduling and times."""

    folder: Path
    slave: tuple[str, ...]
    fifo: bool
    seconds: float
    settle_s: float

    def prepare(self) -> None:
        """Compile the programs and make keys."""
        compile_c(self.folder / "masters", [PEERS / "masters.c", *sorted((PEERS / "masters").glob("*.c"))])
        compile_c(self.folder / "echo", [PEERS / "echo.c"])
        slave, master = new_key(SystemEntropy()), new_key(SystemEntropy())
        write_key(self.folder / "slave.toml", slave)
        (self.folder / "masters.toml").write_text(dump_master(MasterEntry(name="bench", public=master.public)))
        keys = (master.private, slave.public, master.psk)
        (self.folder / "keys").write_text("".join(f"{key.hex()}\n" for key in keys))

    def knows(self, flag: str) -> bool:
        """Return whether this slave supports an option."""
        command = [*self.slave, "slave", "--help"]
        environment = os.environ | {"COLUMNS": "200"}
        return flag in subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout

    def start(self, command: Sequence[object], cpus: set[int], *, fifo: bool, **pipes: Any) -> "subprocess.Popen[str]":
        """Start a process on some CPUs."""

        def place() -> None:
            os.sched_setaffinity(0, cpus)
            if fifo:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))

        return subprocess.Popen([str(each) for each in command], text=True, preexec_fn=place, cwd=self.folder, **pipes)


class Server:
    """A slave or an echo, from its start until `end`.

    Parameters
    ----------
    options
        Options of the slave that make a variant of it; None for the echo.
    """

    def __init__(self, bench: Bench, case: Case, options: Sequence[str] | None) -> None:
        self._report = bench.folder / "report.json"
        self._report.unlink(missing_ok=True)
        if options is None:
            echo = [bench.folder / "echo", case.one_in]
            self._process = bench.start(echo, SERVER_CPUS, fifo=bench.fifo, stdout=subprocess.PIPE)
            assert self._process.stdout is not None
            self.port = int(self._process.stdout.readline())
            return
        keys = ("--key", "slave.toml", "--masters", "masters.toml") if case.sealed else ()
        command = [*bench.slave, "slave", "--listen", "127.0.0.1:0", "--scene", "paper:1", "--report", self._report]
        command += ["--most-sessions", MOST_SESSIONS, "--most-sessions-per-key", MOST_SESSIONS, *keys, *options]
        command += ["--real-time" if bench.fifo else "--no-real-time"]
        said = bench.folder / "slave.log"
        with said.open("w") as log:  # a file: a pipe would fill up, as nothing reads it during the load
            self._process = bench.start(command, SERVER_CPUS, fifo=False, stdout=subprocess.DEVNULL, stderr=log)
        until = time.monotonic() + START_WITHIN_S
        while not (lines := [line for line in said.read_text().splitlines() if "listening on " in line]):
            if self._process.poll() is not None or time.monotonic() > until:
                self.end()
                raise SystemExit(f"the slave did not start: {said.read_text().strip()}")
            time.sleep(0.05)
        self.port = int(lines[0].split("listening on ", 1)[1].split(",", 1)[0].rpartition(":")[2])

    def cpu_ns(self) -> int:
        """Return the processor time of all threads of the server and of its children."""
        total, waiting = 0, [self._process.pid]
        while waiting:
            for task in Path(f"/proc/{waiting.pop()}/task").iterdir():
                total += int((task / "schedstat").read_text().split()[0])
                waiting += map(int, (task / "children").read_text().split())
        return total

    def drops(self) -> int:
        """Return how many datagrams the system dropped because the server did not read them in time."""
        rows = (line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:])
        return sum(int(row[-1]) for row in rows if int(row[1].rpartition(":")[2], 16) == self.port)

    def end(self) -> dict[str, Any] | None:
        """End the server; return a slave's report."""
        self._process.terminate()
        try:
            self._process.communicate(timeout=END_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
        return json.loads(self._report.read_text()) if self._report.exists() else None


def play(bench: Bench, case: Case, options: Sequence[str] | None, masters: int) -> dict[str, Any]:
    """Return the result of one run of a server with this many masters: the generator's counts, and the server's."""
    server = Server(bench, case, options)
    try:
        command: list[object] = [bench.folder / "masters", "--port", server.port, "--masters", masters]
        command += ["--codec", case.codec, "--rate", case.rate_hz, "--sends", case.sends_hz, "--share", case.share]
        command += ["--seconds", bench.seconds, "--settle", bench.settle_s]
        command += ["--keys", bench.folder / "keys"] if case.sealed and options is not None else []
        command += ["--echo"] if options is None else []
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        generator = bench.start(command, GENERATOR_CPUS, fifo=bench.fifo, **pipes)
        assert generator.stderr is not None
        marks = [(server.cpu_ns(), server.drops()) for line in generator.stderr if line.startswith("measur")]
        counts = json.loads(generator.communicate()[0])
    finally:
        report = server.end()
    (cpu_ns, drops), (cpu_end_ns, drops_end) = marks
    counts["server_drops"] = drops_end - drops
    counts["server_cpu_s"] = (cpu_end_ns - cpu_ns) / 1e9
    handled = max(1, counts["positions"] - counts["server_drops"])
    counts["us_per_position"] = counts["server_cpu_s"] * 1e6 / handled
    return counts | (slave_counts(report) if report is not None else {})


def slave_counts(report: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a slave's report over all sessions, from the first HELLO to the last CLOSE."""
    sessions = report["sessions"]
    received = [session["received"] for session in sessions]
    return {
        "slave_steps": sum(session["steps"] for session in sessions),
        "slave_superseded": sum(session["superseded"] for session in sessions),
        "slave_positions": sum(each["by_kind"].get("position", 0) for each in received),
        "slave_lost": sum(each[name] for each in received for name in ("lost", "late", "malformed", "over_rate")),
        "slave_drops": report["overload"]["kernel_drops"],
    }


def compile_c(program: Path, sources: Sequence[Path]) -> None:
    """Compile a C program; the generator needs OpenSSL's libcrypto (libssl-dev)."""
    libraries = ["-lcrypto", "-lm"] if len(sources) > 1 else []
    subprocess.run(["gcc", "-O2", "-o", program, *sources, *libraries], check=True)


def slave_command(program: Path | None) -> tuple[str, ...]:
    """Return the command of hapticnet: a given `hapticnet` or Python, or this Python."""
    if program is not None and program.name.startswith("hapticnet"):
        return (str(program.absolute()),)
    return (sys.executable if program is None else str(program.absolute()), "-m", "hapticnet")
