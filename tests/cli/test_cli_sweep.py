"""``hapticnet sweep`` and ``hapticnet sweep show`` on the command line."""

import csv
import fcntl
import json
import re
import shutil
import signal
import sys

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from hapticnet.errors import FileError
from hapticnet.sweep.engine import Progress
from hapticnet.sweep.results import open_results
from hapticnet.sweep.runs import Shard
from hapticnet.sweep.store import Store, shard_name
from tests.cli.test_cli_errors import assert_only_line
from tests.recordings.session_cases import write_csv

STUDY = """
name = "small"
repeats = 3

[axes]
recording = "force.csv"
codec = ["raw", "deadband"]
multiplier = [1, 2.5]
loss = [0, "10%"]

[show]
by = ["codec", "multiplier"]
of = ["packets_per_s"]
x = "packets_per_s"
y = "felt_rmse_n"
line = ["codec"]
"""


@pytest.fixture
def study(tmp_path):
    t_s = np.arange(200) * 1e-3
    write_csv(tmp_path / "force.csv", {"t_s": t_s, "force_n": 1.0 + np.sin(20.0 * t_s)})
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


@pytest.fixture
def swept(run, study, tmp_path, tmp_path_factory):
    """Return a folder with the results of the study, which are computed once for all tests."""
    kept = tmp_path_factory.getbasetemp() / "swept"
    out = tmp_path / "out"
    if not kept.exists():
        done = run("sweep", study, "--out-dir", out, "--jobs", "1", "--shard", "5", "--json")
        assert done.returncode == 0, done.stderr
        report = json.loads(done.stdout)
        assert report["complete"]
        assert (report["runs"], report["computed"], report["shards"], report["failed"]) == (18, 18, 4, 0)
        shutil.copytree(out, kept)
    shutil.copytree(kept, out, dirs_exist_ok=True)
    return out


def test_show_prints_a_table_csv_and_json_that_agree_and_draws_a_figure(run, swept, tmp_path):
    table = run("sweep", "show", swept)
    assert table.returncode == 0
    assert "small: 18 of 18 runs" in table.stdout
    assert [line.split()[:3] for line in table.stdout.splitlines() if "(" in line][-3:] == [
        ["deadband", "1", "6"],
        ["deadband", "2.5", "6"],
        ["raw", "1", "6"],
    ]
    told = json.loads(run("sweep", "show", swept, "--json", "--of", "sent,felt_rmse_n").stdout)
    assert [row["runs"] for row in told["rows"]] == [6, 6, 6]
    assert {"codec", "multiplier", "runs", "sent_mean", "sent_q5", "felt_rmse_n_q95"} <= set(told["rows"][0])
    file, picture = tmp_path / "table.csv", tmp_path / "figure.svg"
    done = run("sweep", "show", swept, "--of", "sent,felt_rmse_n", "--csv", file, "--plot", picture)
    assert done.returncode == 0, done.stderr
    with file.open() as lines:
        rows = list(csv.DictReader(lines))
    assert [float(row["sent_mean"]) for row in rows] == [row["sent_mean"] for row in told["rows"]]
    assert "</svg>" in picture.read_text()


def test_nothing_in_a_folder_of_results_speaks_to_the_terminal(run, swept):
    evil = "\x1b]0;title\x07[red]"
    about = json.loads((swept / "sweep.json").read_text())
    (swept / "sweep.json").write_text(json.dumps({**about, "name": evil}))
    for shard in list(swept.glob("shard-*.parquet")):
        table = parquet.read_table(shard)
        place = table.schema.get_field_index("codec")
        table = table.set_column(place, "codec", pyarrow.array([evil] * len(table)))
        parquet.write_table(table, shard)
        content = shard.read_bytes()
        shard.rename(swept / shard_name(Shard(*map(int, shard.name.split("-")[1:3])), content))
    done = run("sweep", "show", swept)
    assert done.stdout.startswith("?]0;title?[red]: 18 of 18 runs")
    assert done.stdout.count("?]0;title?[red]") > 1
    assert all(line.isprintable() for line in done.stdout.splitlines())


def test_show_groups_and_selects_as_asked(run, swept):
    asked = ("--by", "loss", "--of", "received", "--where", "codec = 'deadband'", "--json")
    rows = json.loads(run("sweep", "show", swept, *asked).stdout)["rows"]
    assert [(row["loss"], row["runs"]) for row in rows] == [(0.0, 6), (0.1, 6)]
    assert set(rows[0]) == {"loss", "runs", *(f"received_{mark}" for mark in ("mean", "q5", "q50", "q95"))}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--by", "colour"), "there is no setting 'colour'; there are: run, repeat, source"),
        (("--of", "beauty"), "there is no measure 'beauty'"),
        (("--where", "colour = 'red'"), "DuckDB does not understand the condition"),
        (("--plot", "figure.gif"), "figure format is 'gif'"),
        (("--plot", "figure.png", "--x", "codec"), "there is no column of numbers 'codec'"),
        (("--plot", "figure.png", "--where", "loss > 2"), "nothing to draw"),
    ],
)
def test_show_tells_what_it_does_not_have(run, swept, monkeypatch, tmp_path, arguments, text):
    monkeypatch.chdir(tmp_path)
    assert_only_line(run("sweep", "show", swept, *arguments), text, code=2)


def test_the_folder_of_another_study_is_refused_and_kept(run, study, swept):
    before = {path.name: path.read_bytes() for path in swept.iterdir()}
    study.write_text(STUDY.replace("[1, 2.5]", "[1, 3]"))
    assert_only_line(
        run("sweep", study, "--out-dir", swept), "another study ('small'), or this study was changed since", code=2
    )
    study.write_text(STUDY)
    (study.parent / "force.csv").write_text("t_s,force_n\n0,1\n0.001,2\n")
    assert_only_line(run("sweep", study, "--out-dir", swept), "this study was changed since", code=2)
    assert {path.name: path.read_bytes() for path in swept.iterdir()} == before


def test_a_damaged_or_foreign_shard_is_named(run, study, swept):
    (shard,) = swept.glob("shard-0000000005-0000000010-*.parquet")
    content = shard.read_bytes()
    for at in range(4, len(content), 199):
        shard.write_bytes(content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :])
        with pytest.raises(FileError, match=f"^{re.escape(str(shard))} .*; remove it, and its runs are computed again"):
            open_results(Store(swept))
    shard.write_bytes(content[:100] + b"!" + content[101:])
    for verb in (("sweep", "show", swept), ("sweep", study, "--out-dir", swept)):
        assert_only_line(
            run(*verb), f"{shard} was changed or damaged; remove it, and its runs are computed again", code=3
        )
    shard.write_bytes(content[:-20])
    assert_only_line(
        run("sweep", study, "--out-dir", swept), f"{shard} is not a complete shard of a study; remove it", code=3
    )
    shard.unlink()
    foreign = swept / shard_name(Shard(6, 11), content)
    foreign.write_bytes(content)
    assert_only_line(run("sweep", study, "--out-dir", swept), "which does not match its name", code=3)
    foreign.unlink()
    done = run("sweep", study, "--out-dir", swept, "--jobs", "1", "--json")
    assert json.loads(done.stdout)["computed"] == 5


def test_a_folder_that_another_sweep_writes_to_is_left_alone(run, study, swept):
    with (swept / "sweep.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert_only_line(run("sweep", study, "--out-dir", swept), "another sweep is running in this folder", code=4)


def test_what_is_missing_on_the_command_line_or_the_machine_is_told(run, study, swept, tmp_path, monkeypatch):
    assert_only_line(run("sweep", study), "--out-dir DIR is missing", code=2)
    assert_only_line(run("sweep", tmp_path / "none.toml", "--out-dir", tmp_path / "x"), "No such file", code=3)
    assert_only_line(run("sweep", study, "--out-dir", study), "study.toml", code=3)
    assert_only_line(run("sweep", study, "--out-dir", tmp_path / "x", "--jobs", "0"), "--jobs", code=2)
    both = ("--jobs", "1", "--scheduler", "tcp://127.0.0.1:1")
    assert_only_line(run("sweep", study, "--out-dir", tmp_path / "x", *both), "give one of them", code=2)
    assert_only_line(run("sweep", "show", tmp_path), "is not a folder that hapticnet sweep wrote", code=3)
    for package, arguments in (
        ("pyarrow", (study, "--out-dir", tmp_path / "x")),
        ("duckdb", ("show", swept)),
        ("distributed", (study, "--out-dir", tmp_path / "x", *both[2:])),
    ):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)
            assert_only_line(run("sweep", *arguments), "pip install ", code=4)


def test_a_signal_ends_the_sweep_with_its_code_after_the_shards_in_hand(run, study, tmp_path, monkeypatch):
    def conduct(plan, folder, there, pool, *, sizes, is_stopped, on_progress):  # noqa: ARG001
        assert not is_stopped()
        signal.raise_signal(number)
        assert is_stopped()
        return Progress(runs=18, done=5, computed=5, stopped=True)

    monkeypatch.setattr("hapticnet.sweep.engine.sweep", conduct)
    for number in (signal.SIGINT, signal.SIGTERM):
        done = run("sweep", study, "--out-dir", tmp_path / "out")
        assert done.returncode == 128 + number
        assert "stopped with 5 of 18 runs; the same command continues" in done.stderr
