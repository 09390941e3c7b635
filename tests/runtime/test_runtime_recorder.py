"""Rows reach the disk while a run goes on, and a disk that is full, slow or gone ends the recording only."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hapticnet.errors import FileError
from hapticnet.node.recording import Recording
from hapticnet.recordings.tables import read_csv, write_csv
from hapticnet.runtime import recorder as recorder_module
from hapticnet.runtime.recorder import BYTES_PER_NUMBER, SPOOL_SUFFIX, Recorder

COLUMNS = ("t_us", "position_m", "force_n")
PATIENCE_S = 20.0
PLENTY = 2**30


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def recording() -> Recording:
    return Recording(COLUMNS)


def add(recording: Recording, count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Add rows, and return them as columns."""
    rows = np.random.default_rng(seed).normal(size=(count, len(COLUMNS)))
    for row in rows.tolist():
        recording.add(tuple(row))
    return dict(zip(COLUMNS, rows.T, strict=True))


def wait_for(what) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_a_recording_in_pieces_becomes_the_same_file_as_one_written_at_once(tmp_path, recording, said):
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    pieces = []
    for seed in range(5):
        pieces.append(add(recording, 100, seed))
        recorder.collect(recording, tmp_path / "a.csv")
        assert len(recording) == 0, "what is handed over is not kept in memory"
    recorder.end(tmp_path / "a.csv")
    recorder.finish()
    write_csv(tmp_path / "b.csv", {name: np.concatenate([piece[name] for piece in pieces]) for name in COLUMNS})
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.csv", "b.csv"]
    assert said == []
    assert recorder.report() == {"files": 1, "sessions_not_recorded": 0, "stopped": None}


def test_until_then_the_rows_are_in_a_spool_that_can_be_read(tmp_path, recording, said):
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    rows = add(recording, 100)
    recorder.collect(recording, tmp_path / "a.csv")
    spool = tmp_path / f"a.csv{SPOOL_SUFFIX}"
    wait_for(lambda: spool.exists() and spool.stat().st_size > 8 * 3 * 100)
    with spool.open("rb") as file:  # as docs/recordings.md says
        names = file.readline().decode().strip().split(",")
        values = np.frombuffer(file.read()).reshape(-1, len(names))
    assert tuple(names) == COLUMNS
    np.testing.assert_array_equal(values, np.stack(list(rows.values()), axis=1))
    recorder.finish()


def test_a_spool_that_a_killed_run_left_is_not_touched(tmp_path, recording, said):
    left = tmp_path / f"a.csv{SPOOL_SUFFIX}"
    left.write_text("precious")
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    add(recording, 10)
    recorder.collect(recording, tmp_path / "a.csv")
    recorder.finish()
    assert left.read_text() == "precious"
    assert len(read_csv(tmp_path / "a.csv")["t_us"]) == 10


def test_files_are_made_when_nobody_waits(tmp_path, recording, said):
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    add(recording, 1000)
    recorder.collect(recording, tmp_path / "a.csv")
    recorder.end(tmp_path / "a.csv")
    spool = tmp_path / f"a.csv{SPOOL_SUFFIX}"
    wait_for(lambda: spool.exists() and spool.stat().st_size > 8 * 3 * 1000)
    assert not (tmp_path / "a.csv").exists()
    recorder.set_idle(True)
    wait_for(lambda: not spool.exists())
    assert len(read_csv(tmp_path / "a.csv")["t_us"]) == 1000
    recorder.finish()


def test_disk_space_is_bounded(tmp_path, recording, said):
    limit = BYTES_PER_NUMBER * 3 * 250
    recorder = Recorder(said.append, limit_bytes=limit)
    for seed in range(5):
        add(recording, 100, seed)
        recorder.collect(recording, tmp_path / "a.csv")
    recorder.finish()
    assert len(read_csv(tmp_path / "a.csv")["t_us"]) == 200, "what was recorded before is kept"
    assert (tmp_path / "a.csv").stat().st_size <= limit
    assert said == [f"recording stops: the limit of {limit:,} bytes is reached (--record-limit)"]
    assert recorder.report()["stopped"] is not None


def test_the_number_of_files_is_bounded(tmp_path, recording, said, monkeypatch):
    monkeypatch.setattr(recorder_module, "MOST_FILES", 3)
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    for number in range(10):
        for _ in range(2):
            add(recording, 1)
            recorder.collect(recording, tmp_path / f"{number}.csv")
        recorder.end(tmp_path / f"{number}.csv")
    recorder.finish()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["0.csv", "1.csv", "2.csv"]
    assert said == ["3 sessions are recorded; later ones are not", "7 sessions were not recorded"]


def test_a_folder_that_is_gone_is_told_in_one_line_and_ends_the_recording_only(tmp_path, recording, said):
    folder = tmp_path / "gone"
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    for seed in range(3):
        add(recording, 10, seed)
        recorder.collect(recording, folder / "a.csv")
        assert len(recording) == 0
    with pytest.raises(FileError, match=r"incomplete: .*gone.*No such file"):
        recorder.finish()
    assert len([line for line in said if line.startswith("recording stops: ")]) == 1


def test_memory_is_bounded_when_the_disk_is_slow(tmp_path, recording, said, monkeypatch):
    monkeypatch.setattr(recorder_module, "MOST_WAITING_BYTES", 8 * 3 * 250)
    disk = threading.Event()
    append = Recorder._append
    monkeypatch.setattr(Recorder, "_append", lambda *arguments: (disk.wait(PATIENCE_S), append(*arguments)))
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    for seed in range(5):
        add(recording, 100, seed)
        recorder.collect(recording, tmp_path / "a.csv")
    disk.set()
    with pytest.raises(FileError, match="too slow"):
        recorder.finish()
    assert len(read_csv(tmp_path / "a.csv")["t_us"]) == 200
    assert said == [f"recording stops: the disk is too slow for {tmp_path}"]


def test_rows_that_cannot_become_a_file_are_kept(tmp_path, recording, said):
    (tmp_path / "a.csv").mkdir()
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    add(recording, 10)
    recorder.collect(recording, tmp_path / "a.csv")
    with pytest.raises(FileError, match=f"the rows are kept in .*{SPOOL_SUFFIX}"):
        recorder.finish()
    assert (tmp_path / f"a.csv{SPOOL_SUFFIX}").stat().st_size > 8 * 3 * 10


def test_a_fault_in_the_thread_is_told_and_nobody_waits_for_it(tmp_path, recording, said, monkeypatch):
    monkeypatch.setattr(Recorder, "_begin", lambda *_: 1 / 0)
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    add(recording, 10)
    recorder.collect(recording, tmp_path / "a.csv")
    with pytest.raises(FileError, match="ZeroDivisionError"):
        recorder.finish()


def test_an_empty_recording_makes_no_file(tmp_path, recording, said):
    recorder = Recorder(said.append, limit_bytes=PLENTY)
    recorder.collect(recording, tmp_path / "a.csv")
    recorder.end(tmp_path / "a.csv")
    recorder.finish()
    assert list(Path(tmp_path).iterdir()) == []
