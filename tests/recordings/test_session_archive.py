"""Disk space is bounded, and a disk that is full or gone ends the recordings in one line and loses nothing else."""

import errno
import os
from pathlib import Path

import pytest

from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.recordings.session import sink as sink_module
from hapticnet.recordings.session.archive import FILES, check_format
from hapticnet.recordings.session.frames import FrameKind, frame_reader, pack_begin, pack_frame
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.sink import UNFINISHED
from tests.recordings.session_cases import (
    LIVE,
    begin,
    feed,
    give,
    give_rows,
    heading,
    make_archive,
    tick_rows,
    write_session,
)

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def archive(said):
    return make_archive(said)


def record(archive, path):
    """Record ten ticks."""
    begin(archive, path)
    give_rows(archive, tick_rows(10))
    archive.finish()


@pytest.mark.parametrize("suffix", LIVE)
def test_disk_space_is_bounded(tmp_path, said, suffix):
    limit = 100_000
    archive = make_archive(said, limit)
    begin(archive, tmp_path / f"finished{suffix}", recording=2)
    give_rows(archive, tick_rows(100), recording=2)
    give(archive, FrameKind.END, recording=2)
    begin(archive, tmp_path / f"a{suffix}")
    for first in range(0, 10_000, 100):
        give_rows(archive, tick_rows(100, first=first))
        archive.flush()
    archive.finish()
    assert len(read_session(tmp_path / f"finished{suffix}").main["t_us"]) == 100
    assert 100 < len(read_session(tmp_path / f"a{suffix}").main["t_us"]) < 10_000, "what was recorded before is kept"
    assert limit / 2 < sum(file.stat().st_size for file in tmp_path.iterdir()) <= limit
    assert said == [f"False: the limit of {limit:,} bytes for recordings is reached"]


@pytest.mark.parametrize("suffix", LIVE)
def test_a_recording_has_as_many_files_as_its_format_says(tmp_path, suffix, monkeypatch):
    counts = []

    def counting(do):
        def counted(*arguments):
            counts.append(len(list(tmp_path.rglob("*"))))
            return do(*arguments)

        return counted

    for owner, name in ((sink_module.Sink, "flush"), (sink_module.Sink, "discard"), (Path, "replace")):
        monkeypatch.setattr(owner, name, counting(getattr(owner, name)))
    write_session(tmp_path / f"a{suffix}", ticks=200)
    assert (max(counts), len(list(tmp_path.rglob("*")))) == (FILES[suffix] + (suffix == ".csv"), FILES[suffix])


@pytest.mark.parametrize("suffix", LIVE)
def test_a_full_disk_ends_the_recording_in_one_line_and_keeps_what_is_written(
    tmp_path, archive, said, monkeypatch, suffix
):
    begin(archive, tmp_path / f"a{suffix}")
    give_rows(archive, tick_rows(100))
    archive.flush()
    write = os.write

    def short_write(descriptor: int, data: bytes) -> int:
        monkeypatch.setattr(sink_module.os, "write", full)  # some bytes still fit, and then none
        return write(descriptor, data[:50])

    def full(*_: object) -> int:
        raise FULL

    monkeypatch.setattr(sink_module.os, "write", short_write)
    give_rows(archive, tick_rows(100, first=100))
    archive.flush()
    give_rows(archive, tick_rows(100, first=200))
    archive.flush()
    archive.finish()
    monkeypatch.setattr(sink_module.os, "write", write)
    path = tmp_path / f"a{suffix}"
    advice = f"what was written can be completed with 'hapticnet export {path}{UNFINISHED}'"
    assert said == [f"True: {path}: No space left on device; {advice}"]
    assert len(read_session(tmp_path / f"a{suffix}{UNFINISHED}").main["t_us"]) == 100


def test_a_file_that_is_deleted_is_told_in_one_line(tmp_path, archive, said):
    begin(archive, tmp_path / "a.mcap")
    (tmp_path / f"a.mcap{UNFINISHED}").unlink()
    give_rows(archive, tick_rows(10))
    archive.flush()
    archive.finish()
    (line,) = said
    assert "a.mcap: the file was deleted" in line


@pytest.mark.parametrize("suffix", LIVE)
def test_a_folder_that_is_missing_is_told_in_one_line_and_completes_the_other_recordings(
    tmp_path, archive, said, suffix
):
    begin(archive, tmp_path / f"a{suffix}", recording=1)
    give_rows(archive, tick_rows(10), recording=1)
    begin(archive, tmp_path / "gone" / f"b{suffix}", recording=2)
    (line,) = said
    assert line.startswith(f"True: {tmp_path}/gone/b")
    assert line.endswith("No such file or directory")
    assert len(read_session(tmp_path / f"a{suffix}").main["t_us"]) == 10


@pytest.mark.parametrize("suffix", LIVE)
def test_what_a_killed_run_left_is_not_touched(tmp_path, archive, said, suffix):
    left = tmp_path / f"a{suffix}{UNFINISHED}"
    left.write_text("precious")
    record(archive, tmp_path / f"a{suffix}")
    assert left.read_text() == "precious"
    assert len(read_session(tmp_path / f"a{suffix}").main["t_us"]) == 10
    assert said == []


@pytest.mark.parametrize("suffix", LIVE)
def test_rows_that_cannot_become_a_file_are_kept(tmp_path, archive, said, suffix):
    path = tmp_path / f"a{suffix}"
    path.mkdir()
    record(archive, path)
    (line,) = said
    assert f"{path}: Is a directory; what was written can be completed with" in line
    path.rmdir()
    assert len(read_session(tmp_path / f"a{suffix}{UNFINISHED}").main["t_us"]) == 10


def test_parts_of_an_earlier_csv_recording_are_not_taken_for_parts_of_a_new_one(tmp_path, archive):
    write_session(tmp_path / "a.csv", ticks=20)
    record(archive, tmp_path / "a.csv")
    session = read_session(tmp_path / "a.csv")
    assert (list(session.tables), session.events) == (["tick"], ())


def test_parts_of_an_unfinished_csv_recording_stay_together(tmp_path, archive):
    (tmp_path / f"a.events.csv{UNFINISHED}").write_text("precious")
    begin(archive, tmp_path / "a.csv")
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "a.about.json.unfinished-2", "a.csv.unfinished-2", "a.events.csv.unfinished",
    ]  # fmt: skip
    archive.finish()


def test_only_known_formats_are_recorded_and_a_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr("hapticnet.recordings.session.archive.find_spec", lambda _: None)
    for name, error, message in (
        ("run.txt", SettingsError, r"run\.txt: a recording is a \.mcap or \.csv file"),
        ("run.npz", SettingsError, r"run\.npz: .* 'hapticnet export FILE --format npz' converts it"),
        ("run.mcap", UnavailableError, "pip install mcap"),
    ):
        with pytest.raises(error, match=message):
            check_format(Path(name))


def test_frames_arrive_in_any_pieces_and_others_are_refused(tmp_path):
    data = pack_begin(1, heading(tmp_path / "a.mcap")) + pack_frame(FrameKind.END, 1) * 3
    for size in (1, 7, 1000):
        reader, kinds = frame_reader(), []
        for at in range(0, len(data), size):
            reader.feed(data[at : at + size])
            kinds += [kind for kind, *_ in reader]
        assert kinds == [FrameKind.BEGIN, *[FrameKind.END] * 3]
    with pytest.raises(ValueError, match="not a valid FrameKind"):
        feed(make_archive([]), b"\x92\x09\x01")
