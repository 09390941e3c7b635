"""Real processes: started, listened to, and ended by their process id."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import MasterEntry, format_key, new_key
from hapticnet.runtime.system import SystemEntropy
from tests.integration.on_path import OnPath
from tests.ready import ROOT, Started

PATIENCE_S = 20.0


def write_keys(folder: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Make both hosts' keys and the slave's list; return the options of slave and master."""
    own, other = new_key(SystemEntropy()), new_key(SystemEntropy())
    write_key(folder / "slave.toml", own)
    write_key(folder / "master.toml", other)
    (folder / "masters.toml").write_text(dump_master(MasterEntry(name="finger", public=other.public)))
    return (
        ("--key", str(folder / "slave.toml"), "--masters", str(folder / "masters.toml")),
        ("--key", str(folder / "master.toml"), "--peer-key", format_key(own.public)),
    )


class Process:
    """A ``hapticnet`` process whose words can be waited for."""

    def __init__(self, arguments: list[str], prefix: list[str], folder: Path, streams: dict[str, int]) -> None:
        self.errors = folder / f"{arguments[0]}-{time.monotonic_ns()}.err"
        self.output = self.errors.with_suffix(".out")
        command = [*prefix, sys.executable, "-m", "hapticnet", *arguments]
        with self.errors.open("w") as errors, self.output.open("w") as output:
            streams = {"stdout": output.fileno(), "stderr": errors.fileno()} | streams
            self.process: subprocess.Popen | Started = (
                subprocess.Popen(command, stdin=subprocess.DEVNULL, cwd=ROOT, **streams)
                if prefix
                else Started(tuple(arguments), cwd=ROOT, **streams)
            )

    def said(self) -> str:
        return self.errors.read_text()

    def wait_for(self, pattern: str, count: int = 1) -> re.Match[str]:
        """Wait until `pattern` was said `count` times and return the last of them."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            found = list(re.finditer(pattern, self.said()))
            if len(found) >= count:
                return found[count - 1]
            if self.process.poll() is not None and len(re.findall(pattern, self.said())) < count:
                break
            time.sleep(0.01)
        pytest.fail(f"{pattern!r} was not said {count} times; said: {self.said()}")

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)

    def report(self) -> dict:
        return json.loads(self.output.read_text())


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """Return what starts a process without real-time scheduling, killed at the end; `streams` replace its own files."""
    started: list[Process] = []

    def start_process(*arguments: str, prefix: tuple[str, ...] = (), **streams: int) -> Process:
        more = ["--no-real-time"] if arguments[0] in ("slave", "master") else []
        process = Process([*arguments, *more], list(prefix), tmp_path, streams)
        started.append(process)
        return process

    yield start_process
    for process in started:
        if process.process.poll() is None:
            process.process.kill()
            process.process.wait()


@pytest.fixture
def serve(start: Callable[..., Process]) -> Callable[..., tuple[Process, str]]:
    """Return what starts a slave on a free port, and returns it and its address."""

    def start_slave(*arguments: str, prefix: tuple[str, ...] = ()) -> tuple[Process, str]:
        process = start("slave", "--listen", "127.0.0.1:0", *arguments, prefix=prefix)
        return process, process.wait_for(r"listening on ([\d.]+:\d+)").group(1)

    return start_slave


@pytest.fixture
def slave(serve: Callable[..., tuple[Process, str]]) -> tuple[Process, str]:
    """Return a slave with a scene of the paper, and its address."""
    return serve("--scene", "paper:1", "--json")


@pytest.fixture
def paths() -> Iterator[Callable[[str], OnPath]]:
    """Return a maker of attackers on the path to a slave."""
    made: list[OnPath] = []

    def make(slave: str) -> OnPath:
        made.append(OnPath(slave))
        return made[-1]

    yield make
    for path in made:
        path.close()


@pytest.fixture
def free_address() -> str:
    """Return an address at which nobody listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"
