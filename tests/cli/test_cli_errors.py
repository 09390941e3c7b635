"""Whatever is wrong with what a person gives us: one clear line on stderr, an exit code for its kind, no traceback."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.ready import ROOT, hapticnet

TISSUE = """name = "x"
[[tissue]]
name = "skin"
rest_position_m = 0.02
stiffness_n_per_m = 300.0
breach_force_n = 2.0
"""
WRONG_SETTINGS, WRONG_FILE, UNAVAILABLE, REFUSED = 2, 3, 4, 5
"""Exit codes, as docs/use/service.md lists them."""

THE_ERROR = re.compile(r"(\S+Z error )?hapticnet: ")
"""How the line of the error starts; masters and slaves add time and level."""


def assert_one_line(done, *words, code=None):
    """Check for one line with these words and the exit code `code`, by default that of wrong settings or files."""
    assert done.returncode in ({WRONG_SETTINGS, WRONG_FILE} if code is None else {code}), done.stderr
    assert done.stdout == ""
    lines = [line for line in done.stderr.splitlines() if THE_ERROR.match(line)]
    assert len(lines) == 1
    assert done.stderr.splitlines()[-1] == lines[0]
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in lines[0], lines[0]


def assert_only_line(done, *words, code=None):
    """Check the same, and that there is nothing else on stderr."""
    assert_one_line(done, *words, code=code)
    assert done.stderr.count("\n") == 1, done.stderr


@pytest.fixture
def files(tmp_path):
    made = {
        "unknown.toml": TISSUE + "colour = 'red'\n",
        "big.csv": "t_s,force_N\n0.0,1.0\n0.001,1e300\n",
        "two.csv": "t_s,fx,fy\n0,1,2\n",
        "good.csv": "t_s,f,x\n0,1,0\n0.001,2,0.1\n",
        "picture.csv": b"\x89PNG\r\n\x1a\n\0\0",
    }
    for name, text in made.items():
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    return tmp_path


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("missing.csv", ("missing.csv", "No such file")),
        ("two.csv", ("which column?", "t_s, fx, fy")),
        ("picture.csv", ("a binary file of an unknown kind", "own .mcap can be read")),
        ("objects.npy", ("damaged",)),
        ("", ("is a directory",)),
    ],
)
def test_recordings_that_cannot_be_read_are_refused_in_one_line(files, file, words):
    assert_one_line(hapticnet("compare", files / file), *words, code=WRONG_FILE)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("compare", "{files}/two.csv", "--colour", "red"), ("--colour",)),
        (("compare", "{files}/good.csv", "--force-column", "f", "--csv", "/proc/nowhere/out.csv"), ("/proc/nowhere",)),
        (("master", "--record", "{files}/run.csv", "--report", "{files}/run.csv"), ("named as an output twice",)),
        (("slave", "--scene", "missing.toml"), ("missing.toml", "No such file")),
        (("slave", "--scene", "{files}/unknown.toml"), ("unknown.toml", "colour")),
        (("master", "--profile", "{files}/zero.toml"), ("is a character device",)),
        (("fly",), ("fly",)),
        (("compare", "{files}/big.csv"), ("big, sample 1", "1e+300")),
        (("compare", "{files}/two.csv", "--force-column", "fx"), ("1 samples over no time",)),
        (("compare", "{files}/good.csv", "--force-column", "f", "--max-size", "1"), ("the limit is 1",)),
        (("compare", "--force-column", "f_n"), ("none is named",)),
        (
            ("compare", "{files}/good.csv", "--force-column", "f", "--csv", "{files}/good.csv"),
            ("good.csv", "choose another file"),
        ),
        (("compare", "--csv", "{files}/good.csv"), ("good.csv exists", "--overwrite")),
    ],
)
def test_flags_and_files_that_cannot_be_are_refused_in_one_line(files, arguments, words):
    assert_one_line(hapticnet(*(argument.format(files=files) for argument in arguments)), *words)


@pytest.mark.parametrize(
    "arguments",
    [
        ("master", "--record", "/proc/nowhere/x.csv"),
        ("master", "--report", "/proc"),
        ("slave", "--listen", "127.0.0.1:0", "--record-dir", "/proc/nowhere"),
        ("slave", "--listen", "127.0.0.1:0", "--report", "/proc/nowhere/x.json"),
        ("demo", "--out-dir", "/proc/nowhere"),
    ],
)
def test_results_that_cannot_be_written_are_refused_before_the_run(arguments):
    assert_one_line(hapticnet(*arguments), "/proc", code=WRONG_FILE)


def test_a_full_disk_under_stdout_is_one_line():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "hapticnet", "scene", "show"], stdout=full, stderr=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)}, check=False,
        )  # fmt: skip
    assert done.returncode == WRONG_FILE
    assert done.stderr == "hapticnet: stdout cannot be written: No space left on device\n"


@pytest.mark.parametrize("verb", [(), ("scene",)])
def test_without_a_verb_the_help_is_shown_as_it_is_meant_to_be_read(verb):
    done = hapticnet(*verb)
    assert done.returncode == 2
    assert done.stderr.startswith("Usage: ")
    assert len(done.stderr.splitlines()) > 8


def test_a_port_in_use_is_named_in_one_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        assert_one_line(hapticnet("slave", "--listen", address), address, "in use", code=UNAVAILABLE)


def test_hosts_that_do_not_exist_or_are_not_this_machine():
    done = hapticnet("master", "--connect", "no.such.host.invalid:1")
    assert_one_line(done, "cannot find host 'no.such.host.invalid'", code=UNAVAILABLE)
    assert_one_line(hapticnet("slave", "--listen", "192.0.2.1:47800"), "cannot listen", code=UNAVAILABLE)


def test_recordings_of_one_name_stay_apart(tmp_path):
    for folder, scale in (("a", 1.0), ("b", 2.0)):
        (tmp_path / folder).mkdir()
        np.save(tmp_path / folder / "force.npy", scale * np.sin(np.arange(500) * 0.01))
    done = hapticnet(
        "compare", tmp_path / "a" / "force.npy", tmp_path / "b" / "force.npy", "--sampling-rate", "1000",
        "--multipliers", "1", "--codecs", "deadband",
    )  # fmt: skip
    for folder in "ab":
        assert f"{tmp_path / folder / 'force.npy'}: 500 samples" in done.stdout
    assert done.stdout.count("threshold 1 JND") == 3  # each recording, and the mean


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('name = "x"', f'name = "{"x" * 65}"'), ("65 bytes", "1 to 64")),
        (('name = "skin"', 'name = "skin\\nfat"'), ("printable",)),
        (('name = "skin"', 'name = ""'), ("0 bytes",)),
        (("2.0\n", "2.0\n" + TISSUE.partition("\n")[2].replace("0.02", "0.03")), ("2 tissues are called 'skin'",)),
    ],
)
def test_names_that_no_master_could_be_told_are_refused(tmp_path, change, words):
    (tmp_path / "scene.toml").write_text(TISSUE.replace(*change))
    assert_one_line(hapticnet("scene", "show", tmp_path / "scene.toml"), *words)
