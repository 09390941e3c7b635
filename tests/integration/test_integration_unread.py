"""Processes whose output nobody reads: they serve on, end on a signal, and write their report to its file."""

import fcntl
import json
import os
import pty
import signal
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.conftest import PATIENCE_S
from tests.ready import fill, wait_until


@pytest.fixture
def full_pipe() -> Iterator[int]:
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    fill(writer)
    yield writer
    os.close(reader)
    os.close(writer)


@pytest.fixture
def stopped_terminal() -> Iterator[int]:
    """A terminal on which somebody pressed Ctrl-S."""
    controller, terminal = pty.openpty()
    termios.tcflow(terminal, termios.TCOOFF)
    yield terminal
    os.close(controller)
    os.close(terminal)


@pytest.mark.parametrize("stream", ["full_pipe", "stopped_terminal"])
def test_a_slave_whose_stderr_nobody_reads_serves_on_and_ends_on_sigint(start, free_address, stream, request, tmp_path):
    stderr, report = request.getfixturevalue(stream), tmp_path / "slave.json"
    slave = start("slave", "--listen", free_address, "--report", str(report), stderr=stderr)
    for name in ("one", "two"):
        options = ("--name", name, "--duration", "0.3", "--connect-timeout", "20")
        master = start("master", "--connect", free_address, *options)
        assert master.process.wait(PATIENCE_S) == 0
    slave.process.send_signal(signal.SIGINT)
    assert slave.process.wait(PATIENCE_S) == 0
    sessions = json.loads(report.read_text())["sessions"]
    assert [session["master"] for session in sessions] == ["one", "two"]


def test_a_master_whose_stderr_nobody_reads_plays_to_its_end(start, free_address, full_pipe, tmp_path):
    start("slave", "--listen", free_address)
    report = tmp_path / "master.json"
    master = start("master", "--connect", free_address, "--duration", "0.5", "--report", str(report), stderr=full_pipe)
    assert master.process.wait(PATIENCE_S) == 0
    assert json.loads(report.read_text())["end_reason"] == "done"


def test_a_process_none_of_whose_output_is_read_ends_on_one_sigint(start, full_pipe, tmp_path):
    report = tmp_path / "report.json"
    process = start("slave", "--listen", "127.0.0.1:0", "--report", str(report), stdout=full_pipe, stderr=full_pipe)
    wait_until(lambda: handles_signals(process.process.pid))  # nothing that it says can be read
    process.process.send_signal(signal.SIGINT)
    assert process.process.wait(PATIENCE_S) == 3, "the report on stdout is incomplete"
    assert json.loads(report.read_text())["provenance"]


def handles_signals(number: int) -> bool:
    """Tell whether a process has a handler of SIGTERM, which Python itself does not have."""
    status = Path(f"/proc/{number}/status").read_text()
    caught = int(next(line.split()[1] for line in status.splitlines() if line.startswith("SigCgt")), 16)
    return bool(caught >> (signal.SIGTERM - 1) & 1)
