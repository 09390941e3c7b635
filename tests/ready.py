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
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import hapticnet as package

ROOT = Path(__file__).parents[1]
PATIENCE_S = 60
MOST_BYTES = 1 << 17


def hapticnet(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command line in a process; return how it ended, and what it wrote."""
    requests = _nursery()
    with tempfile.TemporaryFile() as stdout, tempfile.TemporaryFile() as stderr, open(os.devnull) as stdin:
        words = [str(argument) for argument in arguments]
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        request = json.dumps([words, str(cwd or Path.cwd()), environment]).encode()
        assert len(request) < MOST_BYTES
        socket.send_fds(requests, [request], [stream.fileno() for stream in (stdin, stdout, stderr)])
        code = int(requests.recv(100))
        written = []
        for stream in (stdout, stderr):
            stream.seek(0)
            written.append(stream.read().decode())
    return subprocess.CompletedProcess(words, code, *written)


@cache
def _nursery() -> socket.socket:
    """Start the process that the others are forked from; it ends when this one does."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    here.settimeout(2 * PATIENCE_S)
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.ready", str(there.fileno())],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        pass_fds=[there.fileno()],
    )
    there.close()
    atexit.register(process.wait)
    atexit.register(here.close)  # runs first
    return here


def _fork_on_request(requests: socket.socket) -> None:
    """Return in a new process for each request, and never in this one."""
    while True:
        data, streams, _, _ = socket.recv_fds(requests, MOST_BYTES, 3)
        if not data:
            os._exit(0)
        words, folder, environment = json.loads(data)
        child = os.fork()
        if child == 0:
            signal.alarm(PATIENCE_S)  # which ends it
            requests.close()
            for number, stream in enumerate(streams):
                os.dup2(stream, number)
                os.close(stream)
            os.chdir(folder)
            os.environ.clear()
            os.environ.update(environment)
            sys.argv = ["hapticnet", *words]
            return
        for stream in streams:
            os.close(stream)
        requests.send(str(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])).encode())


if __name__ == "__main__":
    rooms = [room.name for room in pkgutil.walk_packages(package.__path__, "hapticnet.") if "__" not in room.name]
    for module in (*rooms, "matplotlib.backends.backend_agg", "typer._adapters"):
        with suppress(ImportError):  # of an extra
            importlib.import_module(module)
    gc.freeze()  # otherwise each process would copy all objects at its end, only to look for cycles among them
    _fork_on_request(socket.socket(fileno=int(sys.argv[1])))
    from hapticnet.__main__ import main

    main()
