"""A process beside a node's is never waited for, and ends with it."""

import asyncio
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hapticnet.runtime.frames import pack_frame, read_frames
from hapticnet.runtime.side_process import PIPE_BYTES, SideProcess

PATIENCE_S = 20.0

COPY = """
import os, sys
from hapticnet.runtime.frames import read_frames
for kind, body in read_frames(sys.stdin.buffer):
    os.write(int(sys.argv[1]), b"%d:%s " % (kind, body))
os.write(int(sys.argv[1]), b"end")
"""

SLEEP = """
import os, sys, time
os.write(int(sys.argv[1]), b"here")
time.sleep(3600)
"""


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Return what starts a side process with a program; its argument is a pipe, whose other end is returned too."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])]))
    told: list[str] = []
    started = []

    def make(program):
        (tmp_path / "program.py").write_text(program)
        reader, writer = os.pipe()
        process = SideProcess("program", [writer], name="the process", tell=told.append)
        os.close(writer)
        started.append(process)
        return process, open(reader, "rb", buffering=0), told

    yield make
    for process in started:
        asyncio.run(process.stop())


def test_frames_arrive_and_an_incomplete_one_is_left_out():
    data = pack_frame(0, b"one") + pack_frame(7, b"") + pack_frame(1, b"two")
    assert list(read_frames(io.BytesIO(data))) == [(0, b"one"), (7, b""), (1, b"two")]
    assert list(read_frames(io.BytesIO(data[:-1]))) == [(0, b"one"), (7, b"")]
    assert list(read_frames(io.BytesIO(data[:-4]))) == [(0, b"one"), (7, b"")]


def test_frames_reach_the_process_which_ends_when_it_is_stopped(start):
    process, output, told = start(COPY)
    with output:
        assert process.send(1, b"one")
        assert process.send(0, b"two")
        asyncio.run(process.stop())
        assert output.read(100) + output.read(100) + output.read(100) == b"1:one 0:two end"
    assert told == []
    assert process.left_out == 0


def test_a_process_that_does_not_read_keeps_nobody_waiting_and_is_killed_in_the_end(start):
    process, output, told = start(SLEEP)
    with output:
        assert output.read(4) == b"here"
        sent = [process.send(0, bytes(10_000)) for _ in range(2 * PIPE_BYTES // 10_000)]
        assert sent[0]
        assert not sent[-1]
        assert process.left_out == sent.count(False)
        asyncio.run(process.stop())
        assert output.read() == b"", "it has ended"
    assert told == []


def test_a_process_that_ends_early_is_told_once(start):
    process, output, told = start(SLEEP)
    with output:
        output.read(4)
        os.kill(process.process_id, signal.SIGKILL)
        assert output.read() == b""
        until_s = time.monotonic() + PATIENCE_S
        while process.send(0, b"lost"):  # its end of the pipe may be closed a moment later
            assert time.monotonic() < until_s
        for _ in range(3):
            assert not process.send(0, b"lost")
    assert len(told) == 1
    assert "the process has ended unexpectedly" in told[0]


def test_it_ends_when_the_node_is_killed(tmp_path):
    (tmp_path / "program.py").write_text(COPY)
    parent = (
        "import os, sys\nfrom hapticnet.runtime.side_process import SideProcess\noutput = os.dup(1)\n"
        "process = SideProcess('program', [output], name='it', tell=print)\nprocess.send(0, b'x')\nsys.stdin.read()\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])}
    with subprocess.Popen(
        [sys.executable, "-c", parent], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=environment
    ) as node:
        assert node.stdout is not None
        assert node.stdout.read(4) == b"0:x "
        node.kill()
        assert node.stdout.read(3) == b"end"
