"""Rows reach the writer process while a run goes on. Process, pipe or disk may fail; the run never waits."""

import contextlib
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from hapticnet.errors import FileError, UnavailableError
from hapticnet.node.recording import Recording
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.session import Table
from hapticnet.recordings.session.sink import UNFINISHED
from hapticnet.runtime import recorder as recorder_module
from hapticnet.runtime.recorder import Recorder
from tests.ready import wait_until

COLUMNS = ("t_us", "position_m", "force_n")
PATIENCE_S = 20.0
PLENTY = 2**30


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def recorder(said):
    """Return a recorder whose writer ends with the test."""
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    recorder.start()
    yield recorder
    with contextlib.suppress(ProcessLookupError):
        os.kill(recorder.process.pid, signal.SIGCONT)
    recorder.finish()


def open_file(recorder: Recorder, path: Path) -> int | None:
    return recorder.open(path, "master", [Table("tick", COLUMNS)], 0, {})


def add(recorder: Recorder, number: int, count: int, first: int = 0) -> None:
    recording = Recording(COLUMNS)
    for row in range(first, first + count):
        recording.add((1000.0 * row, 0.5, -0.25))
    recorder.rows(number, 0, recording.take())


def pump_until(recorder: Recorder, what) -> None:
    wait_until(lambda: recorder.pump() or what())


def times(path: Path) -> np.ndarray:
    return read_session(path).main["t_us"]


def test_a_recording_in_pieces_becomes_one_file(tmp_path, recorder, said):
    number = open_file(recorder, tmp_path / "a.mcap")
    for first in range(0, 500, 100):
        add(recorder, number, 100, first)
        recorder.pump()
    recorder.end(number, {"report": {"ticks": 500}})
    recorder.finish()
    recorder.check()
    np.testing.assert_array_equal(times(tmp_path / "a.mcap"), 1000 * np.arange(500))
    assert said == []
    assert recorder.report() == {"begun": 1, "completed": 1, "sessions_not_recorded": 0, "stopped": None}


def test_the_writer_has_normal_priority_and_a_session_of_its_own(said):
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    try:
        recorder.start()
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    pid = recorder.process.pid
    assert os.sched_getscheduler(pid) == os.SCHED_OTHER
    assert os.getsid(pid) == pid != os.getsid(0)
    recorder.finish()
    recorder.check()  # a run without rows is no failure


def test_signals_to_the_writer_do_not_end_it(tmp_path, recorder):
    number = open_file(recorder, tmp_path / "a.csv")
    add(recorder, number, 10)
    pump_until(recorder, (tmp_path / f"a.csv{UNFINISHED}").exists)
    for signal_number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(recorder.process.pid, signal_number)
    add(recorder, number, 10, first=10)
    recorder.finish()
    recorder.check()
    assert len(times(tmp_path / "a.csv")) == 20


@pytest.mark.parametrize("suffix", [".mcap", ".csv"])
def test_a_writer_that_is_killed_is_told_in_one_line_and_its_file_can_be_read(tmp_path, recorder, said, suffix):
    path = tmp_path / f"a{suffix}"
    number = open_file(recorder, path)
    add(recorder, number, 100)
    unfinished = tmp_path / f"a{suffix}{UNFINISHED}"
    pump_until(recorder, lambda: unfinished.exists() and unfinished.stat().st_size > 1200)
    os.kill(recorder.process.pid, signal.SIGKILL)
    pump_until(recorder, lambda: recorder.stopped is not None)
    add(recorder, number, 100, first=100)
    recorder.end(number, {})
    recorder.finish()
    completed = f"'hapticnet export {unfinished}' completes what was written"
    assert said == [f"recording stops: its writer process ended (signal 9); {completed}"]
    with pytest.raises(FileError, match="incomplete: its writer process ended"):
        recorder.check()
    assert len(times(unfinished)) == 100


def test_memory_is_bounded_when_the_disk_is_slow_and_nothing_waits(tmp_path, recorder, said, monkeypatch):
    monkeypatch.setattr(recorder_module, "MOST_WAITING_BYTES", 3 * 2**20)
    number = open_file(recorder, tmp_path / "a.mcap")
    add(recorder, number, 1)
    pump_until(recorder, (tmp_path / f"a.mcap{UNFINISHED}").exists)
    os.kill(recorder.process.pid, signal.SIGSTOP)  # as a disk that does not answer
    block = np.zeros((10_000, 3))
    for first in range(0, 1_000_000, 10_000):
        block[:, 0] = np.arange(first, first + 10_000)
        recording = Recording(COLUMNS)
        recording.add(tuple(block.ravel()))
        recorder.rows(number, 0, recording.take())
        recorder.pump()
    assert said == ["recording stops: the writer cannot keep up; the disk is slow, or the processor busy"]
    os.kill(recorder.process.pid, signal.SIGCONT)
    recorder.finish()
    assert 10_000 < len(times(tmp_path / "a.mcap")) < 500_000, "what was recorded before is kept"
    with pytest.raises(FileError, match="cannot keep up"):
        recorder.check()


def test_a_run_does_not_wait_for_ever_for_a_disk_that_does_not_answer(tmp_path, recorder, said, monkeypatch):
    monkeypatch.setattr(recorder_module, "FINISH_WITHIN_S", 0.1)
    number = open_file(recorder, tmp_path / "a.csv")
    add(recorder, number, 1)
    pump_until(recorder, (tmp_path / f"a.csv{UNFINISHED}").exists)
    os.kill(recorder.process.pid, signal.SIGSTOP)
    recorder.finish()
    assert said == [f"recording stops: the disk is slow; process {recorder.process.pid} continues writing"]
    os.kill(recorder.process.pid, signal.SIGCONT)
    wait_until((tmp_path / "a.csv").exists)


@pytest.mark.parametrize(("suffix", "most"), [(".mcap", 17), (".csv", 4)])
def test_the_number_of_files_is_bounded(tmp_path, recorder, said, monkeypatch, suffix, most):
    """Every file that a session makes counts, whether it is complete or not."""
    monkeypatch.setattr(recorder_module, "FILE_LIMIT", 17)
    numbers = []
    for index in range(20):
        numbers.append(open_file(recorder, tmp_path / f"{index}{suffix}"))
        if index % 2 and numbers[-1] is not None:
            add(recorder, numbers[-1], 1)
            recorder.end(numbers[-1], {})
    assert [number for number in numbers if number is not None] == list(range(1, most + 1))
    recorder.finish()
    assert len(list(tmp_path.rglob("*"))) <= 17
    assert said == [
        "the recordings have 17 files; a session that begins now is not recorded",
        f"{20 - most} sessions were not recorded",
    ]


def test_a_recording_that_the_writer_did_not_get_is_missed(tmp_path, recorder, said):
    """Such as when something else in the process read the first bytes of the pipe."""
    number = open_file(recorder, tmp_path / "a.csv")
    recorder.process.drop()
    add(recorder, number, 10)
    recorder.finish()
    with pytest.raises(FileError, match="incomplete: its writer completed 0 of 1 files"):
        recorder.check()
    assert said == ["recording stops: its writer completed 0 of 1 files"]
    assert recorder.report()["completed"] == 0


def test_a_writer_that_cannot_start_ends_the_run_before_it_begins(tmp_path, said, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "missing"))
    with pytest.raises(UnavailableError, match=r"cannot start hapticnet.runtime.writer: No such file or directory"):
        Recorder(said.append, limit_bytes=PLENTY).start()
