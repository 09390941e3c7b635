"""What the verbs that need no network print."""

import json
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.codec.registry import codec_parameters, every_codec
from hapticnet.recordings.text import read_csv
from tests.ready import ROOT, hapticnet

CODECS = every_codec()

KEYS = {field.name for field in fields(hn.Report)} | {"samples_per_second"}


@pytest.fixture
def trace(tmp_path):
    t = np.arange(2000) / 1000
    path = tmp_path / "force.csv"
    rows = zip(t, 2 + np.sin(2 * np.pi * t), np.cos(2 * np.pi * t), strict=True)
    path.write_text("t_s,fx,fy\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    return path


def test_encode_reports_every_key_and_holds_the_law(trace, tmp_path):
    out = tmp_path / "decoded.csv"
    done = hapticnet("encode", trace, "--force-column", "fx,fy", "--json", "--csv", out)
    report = json.loads(done.stdout)
    assert set(report) == KEYS | {"provenance"}
    assert set(report["provenance"]) == {"version", "date", "machine", "command"}
    assert report["samples"] == 2000
    assert report["exceed_jnd_fraction"] == 0.0
    assert 0.5 < report["packet_rate_reduction"] < 1.0
    decoded = read_csv(out)
    assert list(decoded) == ["t_us", "fx", "fy"]
    error = read_csv(trace)["fx"] - decoded["fx"]
    assert 0.0 < np.abs(error).max() <= report["max_error_n"]


def test_a_report_for_a_person_has_the_same_figures(trace):
    done = hapticnet("encode", trace, "--force-column", "fx")
    shown = {line.split()[0] for line in done.stdout.splitlines()}
    assert KEYS - shown == {"energy_final_j", "energy_peak_j"}, "there are no positions"
    assert shown < KEYS


def test_scene_show_lists_the_tissues():
    report = json.loads(hapticnet("scene", "show", "paper:3", "--json").stdout)
    assert sorted(tissue["breach_force_n"] for tissue in report["tissue"]) == [2.0, 3.5, 5.0]


def test_scene_run_follows_recorded_positions(tmp_path):
    positions, out = tmp_path / "positions.csv", tmp_path / "forces.csv"
    depth = np.concatenate([np.linspace(0, 0.075, 4000), np.linspace(0.075, 0, 2000)])
    positions.write_text("position_m\n" + "".join(f"{value}\n" for value in depth))
    arguments = ("scene", "run", "paper:1", "--trace", positions, "--sampling-rate", "1000")
    printed = hapticnet(*arguments).stdout
    assert hapticnet(*arguments, "--out", out).returncode == 0
    assert out.read_text() == printed
    with (tmp_path / "log").open("a") as log:
        log.write("kept\n")
        log.flush()
        subprocess.run([sys.executable, "-m", "hapticnet", *map(str, arguments)], stdout=log, check=True, cwd=ROOT)
    assert (tmp_path / "log").read_text() == "kept\n" + printed
    table = read_csv(out)
    assert table["breaches"][-1] == 3
    assert table["force_n"].max() == pytest.approx(5.0, abs=0.02)
    assert table["force_n"].min() == 0.0
    assert set(table["tissue 2_contact"]) == {0.0, 1.0, 2.0}


def test_version():
    from hapticnet import __version__
    from hapticnet.compiled import describe_core

    assert describe_core() in ("plain Python", "compiled core")
    assert hapticnet("--version").stdout.strip() == f"hapticnet {__version__} ({describe_core()})"


HELP_AND_LIST_MODULES = """
import sys
sys.argv = ["hapticnet", "--help"]
from hapticnet.cli import main
try:
    main()
except SystemExit:
    print(sorted({"numpy", "msgpack", "pydantic", "uvloop", "asyncio", "matplotlib", "rich"} & set(sys.modules)))
"""


def test_help_imports_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", HELP_AND_LIST_MODULES], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_codecs_lists_every_codec_with_its_parameters():
    done = hapticnet("codecs", "--json")
    listed = json.loads(done.stdout)
    assert [codec["name"] for codec in listed] == list(CODECS)
    for codec in listed:
        assert codec["summary"].endswith(".")
        assert {p["name"]: p["default"] for p in codec["parameters"]} == codec_parameters(CODECS[codec["name"]]())
        assert all(parameter["meaning"] for parameter in codec["parameters"])
    assert all(name in hapticnet("codecs").stdout for name in CODECS)


@pytest.mark.parametrize("verb", ["encode", "compare"])
def test_what_a_recording_lacks_is_told_by_encode_and_compare_alike(tmp_path, verb):
    t_ms = np.arange(1000.0)
    t_ms[500:] += 100
    force = np.sin(t_ms / 50)
    force[42] = 5e5
    file = tmp_path / "faulty.csv"
    file.write_text("t_ms;F (mN)\n" + "".join(f"{t};{f}\n" for t, f in zip(t_ms, force, strict=True)) + "1100;\n")
    done = hapticnet(verb, file, "--missing", "drop", "--max-size", "1MB")
    assert done.returncode == 0, done.stderr
    for words in ("scaled by 0.001 to N", "1 of 1001 rows", "1 gap in time", "up to 500 N at sample 42"):
        assert sum(f"{verb}: {file}: " in line and words in line for line in done.stderr.splitlines()) == 1
