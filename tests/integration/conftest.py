"""Real processes: started, listened to, and ended by their process id."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.ready import ROOT, Started

PATIENCE_S = 20.0


class Process:
    """A ``hapticnet`` process whose words can be waited for."""

    def __init__(self, arguments: list[str], prefix: list[str], folder: Path) -> None:
        self.errors = folder / f"{arguments[0]}-{time.monotonic_ns()}.err"
        self.output = self.errors.with_suffix(".out")
        with self.errors.open("w") as errors, self.output.open("w") as output:
            if prefix:
                self.process: subprocess.Popen | Started = subprocess.Popen(
                    [*prefix, sys.executable, "-m", "hapticnet", *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=errors,
                    cwd=ROOT,
                )
            else:
                self.process = Started(tuple(arguments), stdout=output.fileno(), stderr=errors.fileno(), cwd=ROOT)

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
    """Return what starts a process, without real-time scheduling; those that still run at the end are killed."""
    started: list[Process] = []

    def start_process(*arguments: str, prefix: tuple[str, ...] = ()) -> Process:
        more = ["--no-real-time"] if arguments[0] in ("slave", "master", "replay") else []
        process = Process([*arguments, *more], list(prefix), tmp_path)
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
