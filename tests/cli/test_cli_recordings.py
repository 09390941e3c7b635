"""``hapticnet info`` and ``export``, and the verbs that read recordings."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.recordings.session.frames import FrameKind, pack_begin
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.sink import UNFINISHED
from tests.cli.test_cli_errors import assert_only_line
from tests.recordings.session_cases import (
    ABOUT,
    EVENTS,
    LIVE,
    SUFFIXES,
    feed,
    give,
    give_rows,
    heading,
    make_archive,
    tick_rows,
    write_session,
)

TICKS = 200
NONE = "not a recording of hapticnet"


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "run.mcap"
    write_session(path, ticks=TICKS)
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_info_says_what_a_recording_holds(run, tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    write_session(path, ticks=TICKS)
    account = json.loads(run("info", path, "--json").stdout)
    assert account["complete"] is True
    assert account["side"] == "master"
    assert account["rows"] == {"tick": TICKS, "datagram": 2 * TICKS}
    assert account["duration_s"] == pytest.approx((TICKS - 1) / 1000)
    assert account["rate_hz"] == pytest.approx(1000.0)
    assert account["begun"].startswith("2026-09-21T")
    assert [event["event"] for event in account["events"]] == [name for _, name, _ in EVENTS]
    assert account["about"]["seed"] == ABOUT["seed"]
    assert f"side            master\nbegun           {account['begun']}" in run("info", path).stdout


@pytest.mark.parametrize("suffix", LIVE)
def test_export_completes_what_a_killed_writer_left_and_info_says_that_its_end_is_missing(run, tmp_path, suffix):
    write_session(tmp_path / f"run{suffix}", ticks=TICKS, finish=False)
    for file in sorted(tmp_path.glob(f"run*{UNFINISHED}")):  # of which nobody holds a lock
        shutil.copy(file, tmp_path / file.name.replace("run", "copy"))
    path = tmp_path / f"copy{suffix}"
    advice = f"run 'hapticnet export {path}{UNFINISHED}'"
    assert_only_line(run("info", path), advice, code=FileError.exit_code)
    assert f"wrote {path}" in run("export", f"{path}{UNFINISHED}").stderr
    for _ in range(2):
        assert json.loads(run("info", path, "--json").stdout)["complete"] is False
        assert "complete        no; " in run("info", path).stdout
        run("export", path, "--format", "mcap", "--out", tmp_path / "exported.mcap")
        path = tmp_path / "exported.mcap"


def test_what_is_still_being_written_is_not_exported(run, tmp_path):
    archive = make_archive([])
    feed(archive, pack_begin(1, heading(tmp_path / "run.mcap")))
    give_rows(archive, tick_rows(5))
    archive.flush()
    unfinished = tmp_path / f"run.mcap{UNFINISHED}"
    assert_only_line(run("export", unfinished), "is still being written", code=FileError.exit_code)
    archive.finish()


@pytest.mark.parametrize("suffix", ["csv", "npz", "mcap"])
def test_export_keeps_everything(run, recording, tmp_path, suffix):
    out = tmp_path / f"out.{suffix}"
    assert run("export", recording, "--format", suffix, "--out", out).returncode == 0
    before, after = read_session(recording), read_session(out)
    assert (after.about, after.events, after.side) == (before.about, before.events, before.side)
    for name, columns in before.tables.items():
        assert list(after.tables[name]) == list(columns)
        for column, values in columns.items():
            np.testing.assert_array_equal(after.tables[name][column], values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "choose a format: --format csv, mcap or npz"),
        (("--format", "csv", "--out", "a.npz"), "expected a name that ends in .csv"),
        (("--format", "mcap"), "is an input and would be overwritten"),
    ],
)
def test_an_export_that_cannot_be_meant_is_refused(run, recording, arguments, message):
    assert_only_line(run("export", recording, *arguments), message, code=SettingsError.exit_code)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("force.csv", f"{NONE}: that is a .mcap or .npz file, or a .csv file with force.about.json"),
        ("noise.bin", NONE),
        ("run.events.csv", "a part of a recording; name its main file, "),
        ("gone.csv", "No such file"),
    ],
)
@pytest.mark.parametrize("form", ["csv", "npz"])
def test_an_export_of_what_is_no_recording_says_so_and_writes_nothing(run, tmp_path, name, words, form):
    write_session(tmp_path / "run.csv", ticks=10)
    (tmp_path / "force.csv").write_text("t_s,force_n\n0,1\n0.001,2\n")
    (tmp_path / "noise.bin").write_bytes(bytes(range(256)))
    np.savez(tmp_path / "array.npz", x=np.arange(3))
    before = sorted(tmp_path.iterdir())
    said = f"{tmp_path / name}: {words}"
    assert_only_line(run("export", tmp_path / name, "--format", form), said, code=FileError.exit_code)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["run.about.json", "run.events.csv", "run.datagrams.csv"])
def test_a_part_of_a_recording_is_not_read_as_a_force(run, tmp_path, name):
    write_session(tmp_path / "run.csv", ticks=10)
    said = f"a part of a recording; name its main file, {tmp_path / 'run.csv'}"
    assert_only_line(run("compare", tmp_path / name), said, code=FileError.exit_code)


def test_an_existing_file_is_exported_over_only_with_force(run, recording, tmp_path):
    (tmp_path / "run.events.csv").write_text("precious")
    assert "add --overwrite" in run("export", recording, "--format", "csv").stderr
    assert run("export", recording, "--format", "csv", "--overwrite").returncode == 0


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_person_who_computes_with_a_recording_is_told_what_it_holds(run, tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    write_session(path, ticks=TICKS)
    done = run("compare", path, "--json", "--codecs", "raw")
    assert done.stderr.count("codec, parameters changed during this recording, at t_us 1100000") == 1
    assert done.stderr.count("no true force; received_n is what a master received, compressed already") == 1
    assert json.loads(done.stdout)["recordings"][0]["samples"] == TICKS


def test_info_shows_a_person_a_line_for_each_event_and_what_was_in_force_when(run, recording):
    shown = run("info", recording).stdout.splitlines()
    law = "1 JND (weber 0.05, floor 0.025 N), 1000 Hz, scene paper:1"
    assert shown[shown.index("in_force:") + 1 :][:2] == [
        f"       0.001 s  deadband at {law}, channel in delay=5ms",
        f"       0.100 s  level-crossing:hysteresis=0.5 at {law}, channel in delay=20ms",
    ]
    events = shown[shown.index("events:") + 1 :][:2]
    assert [line.split()[2] for line in events] == ["Connected", "Ended"]
    assert not [line for line in shown if "asked_at_start" in line], "requested settings may differ from those in force"
    note = "channel_in, codec, parameters changed during this recording, at t_us 1100000: "
    assert [line for line in shown if note in line]
    assert "complete        yes" in shown


def test_nothing_in_a_file_speaks_to_the_terminal(run, tmp_path):
    """Such as the sequence that changes the title of its window."""
    evil = "\x1b]0;title\x07"
    plain = heading(tmp_path / "a.csv")
    archive = make_archive([])
    begins = pack_begin(1, replace(plain, side=evil, about={evil: evil, "settings": {"codec": evil}, "more": [evil]}))
    feed(archive, begins)
    give(archive, FrameKind.EVENT, 1_000_000, evil, evil)
    give(archive, FrameKind.EVENT, 1_000_000, "SettingsInForce", json.dumps({"codec": evil}))
    give_rows(archive, tick_rows(5))
    archive.finish()
    np.savez(tmp_path / "b.npz", **{evil: np.zeros((2, 2, 2))})
    for file, code in (("a.csv", 0), ("b.npz", FileError.exit_code)):
        done = run("info", tmp_path / file)
        assert done.returncode == code
        assert "?]0;title?" in done.stdout + done.stderr
        assert all(line.isprintable() for line in (done.stdout + done.stderr).splitlines())


def test_what_cannot_be_replayed_is_one_line(run, tmp_path, recording):
    write_session(tmp_path / "none.npz", ticks=0)
    assert_only_line(run("replay", "--page", "127.0.0.1:0", tmp_path / "none.npz"), "there is nothing to replay")
    assert_only_line(run("replay", "--page", "127.0.0.1:0", recording, "--speed", "9"), "between 0.1 and 4")
    (tmp_path / "gaps.csv").write_text("t,f\n0,nan\n1,nan\n")
    assert_only_line(run("replay", "--missing", "drop", tmp_path / "gaps.csv"), "every row lacks a value")
