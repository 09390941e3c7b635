"""`hapticnet compare`: tables, files and figures."""

import csv
import json
import re

import numpy as np
import pytest

from hapticnet.cli.console import Console
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.experiment.comparison import compare
from hapticnet.experiment.comparison_table import print_rows
from hapticnet.experiment.trials import Trial
from hapticnet.perception import WeberLaw
from hapticnet.recordings.text import read_csv
from tests.ready import hapticnet

CODECS = every_codec()

WIDE = "adaptive-predictive:horizon_ms=150,jump_thresholds=0.5,step_n=0.001"


@pytest.fixture
def traces(tmp_path):
    t_s = np.arange(1500) / 1000
    files = []
    for index in range(3):
        files.append(tmp_path / f"force{index}.csv")
        force = 2 + np.sin(2 * np.pi * t_s) + 0.3 * index * np.sin(9 * t_s)
        np.savetxt(
            files[-1], np.column_stack([t_s, force, np.cos(t_s)]), delimiter=",", header="t_s,fx,fy", comments=""
        )
    return files


def test_every_codec_stands_beside_the_optimum(traces):
    done = hapticnet("compare", traces[0], "--force-column", "fx", "--multipliers", "1,2", "--json")
    account = json.loads(done.stdout)
    rows = account["rows"]
    assert account["settings"]["weber_fraction"] == [0.05]
    assert account["recordings"][0]["samples"] == 1500
    assert {row["codec"] for row in rows} == set(CODECS)
    for row in rows:
        assert row["samples"] == 1500
        assert 0 < row["optimum_lines"] <= row["optimum_holds"] <= 1500
        assert row["over_optimum"] == pytest.approx(row["sent"] / row["optimum_holds"])
        assert row["nanoseconds_per_sample"] > 0.0
        assert row["at_rest"] == CODECS[row["codec"]].needs_position
        assert row["session_wire_bytes"] >= row["wire_bytes"]
    deadband = [row for row in rows if row["codec"] == "deadband"]
    assert [row["multiplier"] for row in deadband] == [1.0, 2.0]
    assert deadband[0]["exceed_jnd_fraction"] == 0.0 < deadband[1]["exceed_jnd_fraction"]
    assert {row["sent"] for row in rows if row["codec"] == "raw"} == {1500}
    assert 1500 > deadband[0]["sent"] > deadband[1]["sent"] > 0


def test_what_differs_in_a_parameter_only_is_told_apart(traces):
    codecs = f"adaptive-predictive;{WIDE}"
    done = hapticnet("compare", traces[0], "--force-column", "fx", "--multipliers", "1", "--codecs", codecs)
    found = [line.split()[0] for line in done.stdout.splitlines() if "predictive" in line]
    assert found == ["adaptive-predictive", WIDE]
    assert "…" not in done.stdout


def test_csv_has_every_figure_at_full_precision_and_says_where_it_comes_from(traces, tmp_path):
    out = tmp_path / "rows.csv"
    done = hapticnet("compare", *traces, "--force-column", "fx", "--codecs", f"deadband;{WIDE}", "--json", "--csv", out)
    rows = json.loads(done.stdout)["rows"]
    comments = [line for line in out.read_text().splitlines() if line.startswith("#")]
    assert [line.split()[1] for line in comments] == ["version:", "date:", "machine:", "command:"]
    assert f"--csv {out}" in comments[-1]
    sent, statistic = read_csv(out, ["sent"])["sent"], [line.split(",")[0] for line in out.read_text().splitlines()[5:]]
    assert sent[: len(rows)].tolist() == [row["sent"] for row in rows]
    assert statistic == ["recording"] * len(rows) + ["mean", "half_width"] * 6
    with out.open() as file:
        cells = list(csv.DictReader(line for line in file if not line.startswith("#")))
    first = [row for row in rows if row["label"] == "deadband" and row["multiplier"] == 1.0]
    mean = next(cell for cell in cells if cell["statistic"] == "mean" and cell["label"] == "deadband")
    assert mean["recordings"] == "3"
    assert float(mean["rmse_n"]) == pytest.approx(np.mean([row["rmse_n"] for row in first]))


def test_the_papers_scene_is_compared_by_default():
    done = hapticnet("compare", "--codecs", "deadband", "--multipliers", "1", "--json")
    account = json.loads(done.stdout)
    assert account["provenance"]["command"].endswith("compare --codecs deadband --multipliers 1 --json")
    (row,) = account["rows"]
    assert row["trial"].startswith("paper's scene")
    assert row["energy_peak_j"] is not None
    assert 1.0 < row["over_optimum"] < 2.5


def test_a_long_run_tells_how_far_it_is_where_there_is_no_terminal(monkeypatch, capfd):
    now_s = [0.0]
    monkeypatch.setattr("hapticnet.cli.console.time.monotonic", lambda: now_s[0])
    console = Console("compare")
    for done in range(1, 41):
        now_s[0] = 0.5 * done
        console.progress(f"{done} of 40")
    console.finish()
    told = [line.rpartition(": ")[2] for line in capfd.readouterr().err.splitlines()]
    assert told == ["10 of 40", "20 of 40", "30 of 40", "40 of 40"]


def test_loss_and_two_axes_are_told_in_the_table(traces):
    codecs = "raw;deadband:step_n=0.001"
    done = hapticnet("compare", traces[0], "--force-column", "fx,fy", "--codecs", codecs, "--loss", "10%")
    assert "deadband:step_n=0.001" in done.stdout
    assert "optimum, hold" in done.stdout
    assert "lost at random" in " ".join(done.stdout.split())


FIGURES = ("bytes-against-error", "packets-against-error", "signal-1-force0")


def test_figures_are_overwritten_only_on_demand_and_the_same_each_time(traces, tmp_path):
    arguments = ("compare", traces[0], "--force-column", "fx", "--codecs", "raw;deadband;merging")
    arguments += ("--plot-dir", tmp_path / "plots")
    assert hapticnet(*arguments).returncode == 0
    drawn = sorted((tmp_path / "plots").iterdir())
    assert [file.name for file in drawn] == [f"{name}.png" for name in FIGURES]
    before = [file.read_bytes() for file in drawn]
    again = hapticnet(*arguments)
    assert again.returncode == 2
    assert "--overwrite" in again.stderr
    assert hapticnet(*arguments, "--overwrite").returncode == 0
    assert [file.read_bytes() for file in drawn] == before


@pytest.mark.parametrize(("recordings", "form", "start"), [(1, "pdf", b"%PDF"), (2, "svg", b"<?xml")])
def test_several_recordings_and_a_constant_force_are_drawn_in_any_format(traces, tmp_path, recordings, form, start):
    still = tmp_path / "still.csv"
    still.write_text("t_s,fx\n" + "".join(f"{n / 1000},0\n" for n in range(500)))
    plots = ("--plot-dir", tmp_path / "plots", "--plot-format", form)
    chosen = ("--codecs", "raw;deadband;linear-predictive", "--multipliers", "1")
    done = hapticnet("compare", still, *traces[: recordings - 1], "--force-column", "fx", *plots, *chosen)
    assert done.returncode == 0, done.stderr
    assert all(line.startswith("compare: picture") for line in done.stderr.splitlines())
    drawn = list((tmp_path / "plots").iterdir())
    assert len(drawn) == recordings + 2
    assert all(file.suffix == f".{form}" and file.read_bytes().startswith(start) for file in drawn)


def rows_and_trials(count=1):
    t_us = np.arange(900) * 1000
    trials = [
        Trial(name=f"hand {n}", t_us=t_us, stimuli=2 + np.sin(t_us * (4 + n) * 1e-6)[:, np.newaxis])
        for n in range(count)
    ]
    codecs = [make_codec("deadband", WeberLaw()), make_codec("velocity-adaptive", WeberLaw())]
    codecs.append(make_codec("adaptive-predictive", WeberLaw(), {"horizon_ms": 150.0, "step_n": 0.001}))
    return compare(trials, codecs), trials


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("recordings", [1, 3])
def test_tables_fit_the_terminal_and_lose_no_number(capsys, width, recordings):
    rows, trials = rows_and_trials(recordings)
    print_rows(rows, trials, 1000)
    wide = capsys.readouterr().out
    print_rows(rows, trials, width)
    narrow = capsys.readouterr().out
    assert max(map(len, narrow.splitlines())) <= width
    assert "…" not in narrow
    numbers = re.compile(r"(?<![\w:=])\d+\.\d+%?(?![\w,])")
    assert sorted(numbers.findall(wide)) == sorted(numbers.findall(narrow))
