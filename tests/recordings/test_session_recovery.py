"""A recording whose writer was killed, or that is cut off or damaged anywhere, gives back what is whole."""

import json
import os
import random
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from hapticnet.errors import FileError, HapticnetError
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.sink import UNFINISHED, refuse_if_recorded
from tests.recordings.session_cases import (
    EVENTS,
    LIVE,
    SUFFIXES,
    begin,
    datagram_rows,
    give_rows,
    make_archive,
    tick_rows,
    write_session,
)

CUTS = 1000
FLIPS = 60
BATCH = 20


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the bytes of a recording of 60 ticks in three chunks, and its ticks."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    rows = write_session(path, ticks=60, batch=BATCH)["tick"]
    return path.read_bytes(), rows


def read_or_refuse(path):
    """Return the recording, or None where it is refused in one line."""
    try:
        return read_session(path)
    except HapticnetError as error:
        fault = str(error)
    assert "\n" not in fault
    return None


def test_a_file_cut_off_at_any_place_gives_back_its_whole_chunks(tmp_path, whole):
    data, rows = whole
    path = tmp_path / "cut.mcap"
    rng = random.Random(1)
    found = []
    for cut in sorted(rng.randrange(len(data)) for _ in range(CUTS)):
        path.write_bytes(data[:cut])
        session, count = read_or_refuse(path), 0
        if session is not None:
            assert not session.complete
            count = len(session.main["t_us"])
            np.testing.assert_array_equal(session.main["t_us"], rows[:count, 0])
            np.testing.assert_array_equal(session.main["held_n"], rows[:count, 3])
        found.append(count)
    assert found == sorted(found), "a longer part of the file never has fewer rows"
    assert set(found) == {0, 20, 40, 60}


def test_a_byte_that_is_changed_costs_at_most_its_chunk_or_what_follows(tmp_path, whole):
    data, rows = whole
    path = tmp_path / "damaged.mcap"
    rng = random.Random(2)
    for _ in range(200):
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        session = read_or_refuse(path)
        if session is not None:
            times = session.main["t_us"]
            assert len(times) % BATCH == 0
            assert len(times) == len(rows) or not session.complete
            assert set(times) <= set(rows[:, 0])


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_what_is_whole_of_a_cut_file_opens_in_the_public_reader(tmp_path, whole, share):
    data, _ = whole
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: int(share * len(data))])
    before = read_session(path)
    whole_again = tmp_path / "whole.mcap"
    export(before, whole_again)
    with whole_again.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        counts = summary.statistics.channel_message_counts
        ticks = next(number for number, channel in summary.channels.items() if channel.topic == "/master/tick")
        assert counts.get(ticks, 0) == len(before.main["t_us"])
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count
    after = read_session(whole_again)
    assert after.is_whole
    assert not after.complete, "something is missing"
    assert after.about.pop("incomplete") == "the source file was cut off or damaged"
    assert after.about == before.about
    np.testing.assert_array_equal(after.main["t_us"], before.main["t_us"])


@pytest.mark.parametrize("suffix", LIVE)
def test_what_a_killed_writer_left_is_read_like_a_complete_recording(tmp_path, suffix):
    path, left = tmp_path / f"run{suffix}", tmp_path / f"run{suffix}{UNFINISHED}"
    write_session(path, ticks=300, finish=False)
    with pytest.raises(FileError, match=f"hapticnet export .*{UNFINISHED}"):
        read_session(path)
    session = read_session(left)
    assert not session.complete
    assert [tuple(event) for event in session.events] == EVENTS
    np.testing.assert_array_equal(session.main["held_n"], tick_rows(300)[:, 3])
    np.testing.assert_array_equal(session.tables["datagram"]["t_us"], datagram_rows(600)[:, 0])


def test_rows_and_events_that_were_not_written_completely_are_left_out(tmp_path):
    write_session(tmp_path / "run.csv", ticks=300, finish=False)
    for name in ("run.csv", "run.events.csv"):
        torn = tmp_path / f"{name}{UNFINISHED}"
        torn.write_bytes(torn.read_bytes()[:-5])
    session = read_session(tmp_path / f"run.csv{UNFINISHED}")
    assert (len(session.main["t_us"]), len(session.events)) == (299, len(EVENTS) - 1)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_flipped_bits_are_refused_in_one_line_or_harm_nothing(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    write_session(path, ticks=100)
    whole, rng, refused = path.read_bytes(), np.random.default_rng(5), 0
    for flip in range(FLIPS):
        data = bytearray(whole)
        for at in rng.integers(len(data), size=1 + flip % 8):
            data[at] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        session = read_or_refuse(path)
        refused += session is None
        if session is not None:
            export(session, tmp_path / "again.mcap")
    assert refused > (0 if suffix == ".mcap" else FLIPS // 2)  # of an .mcap file, the other chunks are whole


def test_a_numpy_archive_whose_arrays_do_not_fit_together_is_refused(tmp_path):
    path = tmp_path / "run.npz"
    write_session(path, ticks=100)
    with np.load(path) as arrays:
        whole = dict(arrays)
    for damage, message in (
        ({"held_n": whole["held_n"][:50]}, "the columns of its table of ticks do not match"),
        ({"held_n": np.array(["1"] * 100)}, "the columns of its table of ticks do not match"),
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
def test_a_recording_that_is_being_written_is_left_alone_and_so_is_its_name(tmp_path, suffix):
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
    assert len(read_session(path).main["t_us"]) == 10


def test_what_is_no_file_is_refused_without_waiting_for_it(tmp_path):
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), Path("/dev/null"), Path()):
        with pytest.raises(FileError, match=r"expected a regular file"):
            read_session(path)
