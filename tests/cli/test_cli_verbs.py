"""What the verbs that need no network print."""

import json
import subprocess
import sys

import numpy as np

from hapticnet.codec.registry import codec_parameters, every_codec
from tests.ready import hapticnet

CODECS = every_codec()


def test_scene_show_lists_the_tissues():
    report = json.loads(hapticnet("scene", "show", "paper:3", "--json").stdout)
    assert sorted(tissue["breach_force_n"] for tissue in report["tissue"]) == [2.0, 3.5, 5.0]


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


def test_what_a_recording_lacks_is_told(tmp_path):
    t_ms = np.arange(1000.0)
    t_ms[500:] += 100
    force = np.sin(t_ms / 50)
    force[42] = 5e5
    file = tmp_path / "faulty.csv"
    file.write_text("t_ms;F (mN)\n" + "".join(f"{t};{f}\n" for t, f in zip(t_ms, force, strict=True)) + "1100;\n")
    done = hapticnet("compare", file, "--missing", "drop", "--max-size", "1MB", "--codecs", "deadband")
    assert done.returncode == 0, done.stderr
    for words in ("scaled by 0.001 to N", "1 of 1001 rows", "1 gap in time", "up to 500 N at sample 42"):
        assert sum(f"compare: {file}: " in line and words in line for line in done.stderr.splitlines()) == 1
