"""A recording whose writer was killed, or that is cut off or damaged anywhere, gives back what is whole."""

import os
import random
import shutil

import numpy as np
import pytest
from mcap.reader import make_reader

from hapticnet.errors import FileError, HapticnetError
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.recovery import recover_file
from hapticnet.recordings.session.sink import UNFINISHED
from tests.recordings.session_cases import EVENTS, LIVE, begin, give_rows, make_archive, tick_rows, write_session

CUTS = 1000
BATCH = 20


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the bytes of a recording of 60 ticks in three chunks, and its ticks."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    rows = write_session(path, ticks=60, batch=BATCH)["tick"]
    return path.read_bytes(), rows


def read_or_refuse(path):
    """Return the recording, or None and the message of the error."""
    try:
        return read_session(path), ""
    except HapticnetError as error:
        return None, str(error)


def test_a_file_cut_off_at_any_place_gives_back_its_whole_chunks(tmp_path, whole):
    data, rows = whole
    path = tmp_path / "cut.mcap"
    rng = random.Random(1)
    found = []
    for cut in sorted(rng.randrange(len(data)) for _ in range(CUTS)):
        path.write_bytes(data[:cut])
        session, fault = read_or_refuse(path)
        count = 0
        if session is None:
            assert "\n" not in fault
        else:
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
        session, fault = read_or_refuse(path)
        if session is None:
            assert "\n" not in fault
        else:
            times = session.main["t_us"]
            assert len(times) % BATCH == 0
            assert len(times) == len(rows) or not session.complete
            assert set(times) <= set(rows[:, 0])


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_what_is_recovered_opens_in_the_public_reader(tmp_path, whole, share):
    data, _ = whole
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: int(share * len(data))])
    before = read_session(path)
    done = recover_file(path)
    assert done.path == tmp_path / "cut-recovered.mcap"
    assert path.exists(), "the original is kept"
    with done.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        counts = summary.statistics.channel_message_counts
        ticks = next(number for number, channel in summary.channels.items() if channel.topic == "/master/tick")
        assert counts.get(ticks, 0) == done.count
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count
    after = read_session(done.path)
    assert after.is_whole
    assert not after.complete, "something is missing"
    assert after.about.pop("incomplete") == "the file that it comes from was cut off or damaged"
    assert after.about == before.about
    np.testing.assert_array_equal(after.main["t_us"], before.main["t_us"])


def test_a_complete_file_needs_no_recovery(tmp_path, whole):
    path = tmp_path / "run.mcap"
    path.write_bytes(whole[0])
    done = recover_file(path)
    assert done.was_complete
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]


@pytest.mark.parametrize("suffix", LIVE)
def test_what_a_killed_writer_left_becomes_a_complete_recording(tmp_path, suffix):
    path = tmp_path / "copy" / f"run{suffix}"
    rows = write_session(tmp_path / f"run{suffix}", ticks=300, finish=False)
    (tmp_path / "copy").mkdir()
    for file in tmp_path.glob("run.*"):  # a copy, since this process still has the originals open
        shutil.copy(file, tmp_path / "copy" / file.name)
    with pytest.raises(FileError, match=f"hapticnet recover .*{UNFINISHED}"):
        read_session(path)
    done = recover_file(path)
    assert (done.path, done.was_complete) == (path, False)
    session = read_session(path)
    assert [tuple(event) for event in session.events] == EVENTS
    np.testing.assert_array_equal(session.main["held_n"], rows["tick"][:, 3])
    np.testing.assert_array_equal(session.tables["datagram"]["t_us"], rows["datagram"][:, 0])
    assert not list((tmp_path / "copy").glob("*.unfinished*"))


def test_a_row_that_was_not_written_completely_is_left_out(tmp_path):
    path = left_behind(tmp_path, ".csv")
    path.write_bytes(path.read_bytes()[:-5])
    assert recover_file(path).count == 299


@pytest.mark.parametrize("suffix", LIVE)
def test_a_recording_that_is_being_written_is_left_alone(tmp_path, suffix):
    said: list[str] = []
    archive = make_archive(said)
    begin(archive, tmp_path / f"run{suffix}")
    give_rows(archive, tick_rows(10))
    archive.flush()
    with pytest.raises(FileError, match="still being written"):
        recover_file(tmp_path / f"run{suffix}")
    archive.finish()
    assert len(read_session(tmp_path / f"run{suffix}").main["t_us"]) == 10


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.mcap", None, "no such file"),
        ("a.csv", b"t_us,x\n", "only .mcap files and"),
        ("empty.mcap", b"", "not an MCAP file"),
        ("text.mcap", b"t_us,x\n1,2\n", "not an MCAP file"),
        ("a.npz.unfinished", b"PK", "not an unfinished recording"),
        ("a.txt.unfinished", b"", "not an unfinished recording"),
    ],
)
def test_what_cannot_be_recovered_is_told_in_one_line(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError, match=message) as caught:
        recover_file(path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.glob("*-recovered*"))


def test_an_existing_file_is_not_replaced(tmp_path, whole):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[0][:-100])
    (tmp_path / "cut-recovered.mcap").write_text("precious")
    with pytest.raises(FileError, match="exists; name another file with --out"):
        recover_file(path)
    assert recover_file(path, tmp_path / "other.mcap").count > 0


def left_behind(tmp_path, suffix, ticks=300):
    """Return a recording whose writer was killed, in a folder of its own."""
    write_session(tmp_path / f"run{suffix}", ticks=ticks, finish=False)
    shutil.copytree(tmp_path, tmp_path / "copy", ignore=shutil.ignore_patterns("copy"))
    return tmp_path / "copy" / f"run{suffix}{UNFINISHED}"


@pytest.mark.parametrize(
    "name",
    ["run.csv.unfinished", "run.events.csv.unfinished", "run.about.json.unfinished", "run.mcap.unfinished"],
)
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_link_or_a_pipe_in_the_place_of_a_file_is_refused_and_nothing_is_changed(tmp_path, name, kind):
    path = left_behind(tmp_path, ".mcap" if ".mcap" in name else ".csv")
    precious, file = tmp_path / "precious", path.parent / name
    file.rename(precious)
    os.mkfifo(file) if kind == "pipe" else file.symlink_to(precious)
    before = precious.stat()
    with pytest.raises(FileError, match=r"is a (link|pipe); "):
        recover_file(path)
    assert precious.stat() == before
    assert path.exists()
