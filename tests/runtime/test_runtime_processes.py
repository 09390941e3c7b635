"""A process beside a node's is never waited for, and ends with it."""

import os
import signal
from pathlib import Path

import pytest

from hapticnet.runtime.processes import PIPE_BYTES, SideProcess
from tests.ready import wait_until

PATIENCE_S = 20.0

COPY = """
import sys
print("here", flush=True)
for line in sys.stdin:
    print("got", line, end="", flush=True)
print("end", flush=True)
"""

SLEEP = """
import time
print("here", flush=True)
time.sleep(3600)
"""


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Return what starts a side process with a program, and waits until it says "here"."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])]))
    started = []

    def make(program: str) -> SideProcess:
        (tmp_path / "program.py").write_text(program)
        started.append(SideProcess("program"))
        assert wait_until(started[-1].said) == [b"here"]
        return started[-1]

    yield make
    for process in started:
        process.close()


def test_what_is_put_reaches_the_process_which_ends_when_its_input_ends(start):
    process = start(COPY)
    process.put(b"one\ntw")
    process.put(memoryview(b"o\n"))
    assert process.finish(PATIENCE_S)
    assert process.exit_code == 0
    assert process.said() == [b"got one", b"got two", b"end"]


def test_a_process_that_does_not_read_keeps_nobody_waiting_and_is_killed_in_the_end(start):
    process = start(SLEEP)
    process.put(bytes(2 * PIPE_BYTES))
    for _ in range(10):
        process.pump()
    assert 0 < process.waiting_bytes < 2 * PIPE_BYTES
    assert not process.finish(0.05)
    process.close()
    assert process.exit_code == -signal.SIGKILL


def test_nothing_waits_for_a_process_that_has_ended(start):
    process = start(SLEEP)
    os.kill(process.pid, signal.SIGKILL)
    assert wait_until(lambda: process.exit_code) == -signal.SIGKILL
    process.put(b"lost")
    process.pump()
    assert process.waiting_bytes == 0
    assert process.said() == []
