"""Damaged recordings are read as far as they are whole, or refused in one line."""

import json
import os
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from hapticnet.errors import FileError
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.recovery import recover_file, refuse_if_recorded
from hapticnet.recordings.session.sink import UNFINISHED
from tests.recordings.session_cases import LIVE, SUFFIXES, begin, give_rows, make_archive, tick_rows, write_session

FLIPS = 60


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_flipped_bits_are_refused_in_one_line_or_harm_nothing(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    write_session(path, ticks=100)
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    refused: list[str] = []
    for flip in range(FLIPS):
        data = bytearray(whole)
        for at in rng.integers(len(data), size=1 + flip % 8):
            data[at] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            export(read_session(path), tmp_path / "again.mcap")
        except FileError as error:
            refused.append(str(error))
    assert not any("\n" in message for message in refused)
    assert len(refused) > (0 if suffix == ".mcap" else FLIPS // 2)  # of an .mcap file, the other chunks are whole


def test_a_numpy_archive_whose_arrays_do_not_fit_together_is_refused(tmp_path):
    path = tmp_path / "run.npz"
    write_session(path, ticks=100)
    with np.load(path) as arrays:
        whole = dict(arrays)
    for damage, message in (
        ({"held_n": whole["held_n"][:50]}, "the columns of its table of ticks do not fit together"),
        ({"held_n": np.array(["1"] * 100)}, "the columns of its table of ticks do not fit together"),
        ({"other.direction": np.zeros(3)}, "its table of others has no times"),
        ({"t_us": whole["t_us"] * 10**12}, "the times of its table of ticks are out of range"),
        ({"events": np.array(json.dumps([["now", "Connected", ""]]))}, "not a recording of hapticnet"),
    ):
        np.savez(path, **{**whole, **damage})
        with pytest.raises(FileError, match=message):
            read_session(path)
    for offset_us in (-(10**17), 10**17):
        about = json.loads(str(whole["about"])) | {"unix_offset_us": offset_us}
        np.savez(path, **{**whole, "about": np.array(json.dumps(about))})
        with pytest.raises(FileError, match="MCAP has no times before 1970 or after 2554"):
            export(read_session(path), tmp_path / "far.mcap")
    about = json.loads(str(whole["about"])) | {"unix_offset_us": 10**30}
    np.savez(path, **{**whole, "about": np.array(json.dumps(about))})
    assert read_session(path).unix_offset_us == 0


@pytest.mark.parametrize("suffix", LIVE)
def test_a_name_that_another_session_records_under_is_refused(tmp_path, suffix):
    path = tmp_path / f"run [1]{suffix}"
    refuse_if_recorded(path)
    archive = make_archive([])
    begin(archive, path)
    give_rows(archive, tick_rows(10))
    archive.flush()
    with pytest.raises(FileError, match="is still being written"):
        refuse_if_recorded(path)
    archive.finish()
    refuse_if_recorded(path)


def test_what_is_no_file_is_refused_without_waiting_for_it(tmp_path):
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), Path("/dev/null"), Path()):
        with pytest.raises(FileError, match=r"expected a regular file|can be recovered"):
            recover_file(path, tmp_path / "out.mcap")
        with pytest.raises(FileError, match=r"expected a regular file"):
            read_session(path)


@pytest.mark.parametrize("suffix", LIVE)
def test_a_recording_can_be_recovered_to_another_disk(tmp_path, suffix):
    copy = tmp_path / "copy"  # since this process still has the originals open
    write_session(tmp_path / f"run{suffix}", ticks=100, finish=False)
    shutil.copytree(tmp_path, copy, ignore=shutil.ignore_patterns("copy"))
    unfinished = copy / f"run{suffix}{UNFINISHED}"
    with TemporaryDirectory(dir="/dev/shm") as other:
        if os.stat(other).st_dev == os.stat(tmp_path).st_dev:
            pytest.skip("there is only one file system")
        target = Path(other) / f"run{suffix}"
        assert recover_file(unfinished, target).count >= 100
        assert len(read_session(target).main["t_us"]) == 100
        assert not list(copy.iterdir())
