"""``hapticnet info``, ``recover``, ``export`` and ``replay``, and the verbs that read recordings."""

import json
import shutil

import numpy as np
import pyarrow.parquet
import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.sink import UNFINISHED
from tests.recordings.session_cases import ABOUT, EVENTS, SUFFIXES, write_session

TICKS = 200


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


def test_recover_completes_and_says_so(run, tmp_path):
    write_session(tmp_path / "run.mcap", ticks=TICKS, finish=False)
    copy = tmp_path / f"copy.mcap{UNFINISHED}"
    shutil.copy(tmp_path / f"run.mcap{UNFINISHED}", copy)
    done = run("info", tmp_path / "copy.mcap")
    assert done.returncode == FileError.exit_code
    assert f"run 'hapticnet recover {copy}'" in done.stderr
    done = run("recover", copy, "--json")
    assert json.loads(done.stdout)["file"] == str(tmp_path / "copy.mcap")
    assert read_session(tmp_path / "copy.mcap").complete
    assert "there is nothing to recover" in run("recover", tmp_path / "copy.mcap").stderr


def test_recover_says_if_nothing_is_whole(run, tmp_path):
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    done = run("recover", tmp_path / "run.mcap", "--json")
    assert "nothing in" in done.stderr
    assert json.loads(done.stdout)["recovered"] == 0


@pytest.mark.parametrize("suffix", ["csv", "npz", "mcap"])
def test_export_keeps_everything(run, recording, tmp_path, suffix):
    out = tmp_path / f"out.{suffix}"
    assert run("export", recording, f"--{suffix}", "--out", out).returncode == 0
    before, after = read_session(recording), read_session(out)
    assert (after.about, after.events, after.side) == (before.about, before.events, before.side)
    for name, columns in before.tables.items():
        assert list(after.tables[name]) == list(columns)
        for column, values in columns.items():
            np.testing.assert_array_equal(after.tables[name][column], values)


def test_export_writes_parquet_with_the_configuration(run, recording, tmp_path):
    assert run("export", recording, "--parquet").returncode == 0
    table = pyarrow.parquet.read_table(tmp_path / "run.parquet")
    np.testing.assert_array_equal(table["held_n"].to_numpy(), read_session(recording).main["held_n"])
    assert json.loads(table.schema.metadata[b"hapticnet"])["seed"] == ABOUT["seed"]
    assert pyarrow.parquet.read_table(tmp_path / "run.datagrams.parquet").num_rows == 2 * TICKS
    assert pyarrow.parquet.read_table(tmp_path / "run.events.parquet")["event"].to_pylist() == ["Connected", "Ended"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "choose one format"),
        (("--csv", "--npz"), "choose one format"),
        (("--csv", "--out", "a.npz"), "expected a name that ends in .csv"),
        (("--mcap",), "is an input and would be overwritten"),
    ],
)
def test_an_export_that_cannot_be_meant_is_refused(run, recording, arguments, message):
    done = run("export", recording, *arguments)
    assert done.returncode == SettingsError.exit_code
    assert message in done.stderr


def test_an_existing_file_is_exported_over_only_with_force(run, recording, tmp_path):
    (tmp_path / "run.events.csv").write_text("precious")
    assert "add --force" in run("export", recording, "--csv").stderr
    assert run("export", recording, "--csv", "--force").returncode == 0


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_encode_reads_the_received_force_of_a_recording(run, tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    write_session(path, ticks=TICKS)
    done = run("encode", path, "--json")
    assert json.loads(done.stdout)["samples"] == TICKS
    assert done.stderr.count("no true force; received_n is what a master received, compressed already") == 1


def test_info_shows_a_person_a_line_for_each_event_and_the_settings_that_matter(run, recording):
    shown = run("info", recording).stdout.splitlines()
    events = shown[shown.index("events:") + 1 :][: len(EVENTS)]
    assert [line.split()[2] for line in events] == [name for _, name, _ in EVENTS]
    assert "complete        yes" in shown


def test_compare_and_trace_read_a_recording(run, recording):
    done = run("compare", recording, "--codecs", "raw", "--json")
    assert json.loads(done.stdout)["recordings"][0]["samples"] == TICKS
    assert run("scene", "run", "paper", "--positions", recording).stdout.count("\n") == TICKS + 1


def test_replay_refuses_what_does_not_fit(run, tmp_path):
    write_session(tmp_path / "run.csv", ticks=10, axes=3)
    done = run("replay", tmp_path / "run.csv", "--column", "held_x_n")
    assert done.returncode == SettingsError.exit_code
    assert "a force of 1 axes for positions of 3" in done.stderr
    done = run("replay", tmp_path / "run.csv", "--column", "held_x_n", "--connect", "127.0.0.1:9")
    assert "with --connect the slave's scene makes the force" in done.stderr
