"""Run ``hapticnet`` in real processes that start fast: each is forked from one that has imported what the verbs need.

A process of its own for each command line, with its own streams, folder and end, as from ``python -m hapticnet``; only
the half second of imports is saved. What tests the start itself, or another environment, starts Python.
"""

import atexit
import gc
import importlib
import json
import os
import pkgutil
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

import hapticnet as package

ROOT = Path(__file__).parents[1]
PATIENCE_S = 60
PYTHONPATH = os.pathsep.join(map(str, (ROOT, ROOT / "extras" / "experiment")))
MOST_BYTES = 1 << 17


class Started:
    """A process with the methods of `subprocess.Popen` that tests use."""

    def __init__(self, arguments: tuple[object, ...], *, stdout: int, stderr: int, cwd: Path | None = None) -> None:
        self.args = [str(argument) for argument in arguments]
        self.returncode: int | None = None
        environment = os.environ | {"PYTHONPATH": PYTHONPATH}
        request = json.dumps([self.args, str(cwd or Path.cwd()), environment]).encode()
        assert len(request) < MOST_BYTES
        self._status, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with there, open(os.devnull) as stdin:
            socket.send_fds(_nursery(), [request], [stdin.fileno(), stdout, stderr, there.fileno()])
        self._status.settimeout(PATIENCE_S)
        self.pid = int(self._status.recv(100))

    def poll(self) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            return self.wait(0.0)
        return None

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            if not select.select([self._status], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
            self.returncode = int(self._status.recv(100))
            self._status.close()
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def hapticnet(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command line in a process; return how it ended, and what it wrote."""
    with tempfile.TemporaryFile() as stdout, tempfile.TemporaryFile() as stderr:
        process = Started(arguments, stdout=stdout.fileno(), stderr=stderr.fileno(), cwd=cwd)
        code = process.wait(2 * PATIENCE_S)
        written = []
        for stream in (stdout, stderr):
            stream.seek(0)
            written.append(stream.read().decode())
    return subprocess.CompletedProcess(process.args, code, *written)


def wait_until(condition, within_s=PATIENCE_S):
    """Wait for a condition, and return what made it true."""
    end_s = time.monotonic() + within_s
    while not (found := condition()):
        assert time.monotonic() < end_s, "it takes too long"
        time.sleep(0.002)
    return found


def fill(stream: int) -> int:
    """Write to a pipe until it takes no more; return how much it holds."""
    os.set_blocking(stream, False)
    filled = 0
    with suppress(BlockingIOError):
        while True:
            filled += os.write(stream, b".")
    os.set_blocking(stream, True)
    return filled


def children_of(number):
    """Return the numbers of the processes that a process has started."""
    return [int(each) for each in Path(f"/proc/{number}/task/{number}/children").read_text().split()]


def is_running(number):
    """Tell whether a process runs; one that has ended may still wait for somebody to ask how."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@cache
def _nursery() -> socket.socket:
    """Start the process that the others are forked from; it ends when this one does."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.ready", str(there.fileno())],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": PYTHONPATH},
        stdin=subprocess.DEVNULL,
        pass_fds=[there.fileno()],
    )
    there.close()
    atexit.register(process.wait)
    atexit.register(here.close)  # runs first
    return here


def _fork_on_request(requests: socket.socket) -> None:
    """Return in a new process for each request, and never in this one."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the keepers
    while True:
        data, descriptors, _, _ = socket.recv_fds(requests, MOST_BYTES, 4)
        if not data:
            os._exit(0)
        if os.fork() == 0:
            requests.close()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            *streams, number = descriptors
            status = socket.socket(fileno=number)
            if (child := os.fork()) == 0:
                status.close()
                _become(*json.loads(data), streams)
                return
            _keep(child, status)
        for descriptor in descriptors:
            os.close(descriptor)


def _become(words: list[str], folder: str, environment: dict[str, str], streams: list[int]) -> None:
    signal.alarm(PATIENCE_S)  # which ends it
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["hapticnet", *words]


def _keep(child: int, status: socket.socket) -> None:
    """Tell the number of a process, and how it ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):  # the test has ended
        status.send(str(child).encode())
        status.send(str(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])).encode())
    os._exit(0)


if __name__ == "__main__":
    rooms = [room.name for room in pkgutil.walk_packages(package.__path__, "hapticnet.") if "__" not in room.name]
    for module in (*rooms, "matplotlib.backends.backend_agg", "typer._adapters"):
        with suppress(ImportError):  # of an extra
            importlib.import_module(module)
    gc.freeze()  # otherwise each process would copy all objects at its end, only to look for cycles among them
    _fork_on_request(socket.socket(fileno=int(sys.argv[1])))
    from hapticnet.__main__ import main

    main()
