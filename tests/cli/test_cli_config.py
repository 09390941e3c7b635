"""Options come from the command line, the environment and a file, in this order; what is misspelt is told."""

import json
import re

import pytest

FILE = """
[master]
codec = "raw"
rate = 500
real-time = false
passive = true

[device.step]
from = 0.7

[slave]
add-codec = ["a.py:One", "b.py:Two"]
"""


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(FILE)
    return path


def resolved(done):
    assert done.returncode == 0, done.stderr
    return {row["option"]: (row["value"], row["source"]) for row in json.loads(done.stdout)}


def test_the_command_line_precedes_the_environment_which_precedes_the_file(run, rig):
    done = run(
        "config", "--json", "master", "--config", rig, "--weber", "0.1", "--rate", "250", "--no-passive",
        HAPTICNET_MASTER_RATE="300", HAPTICNET_MASTER_CODEC="deadband", HAPTICNET_MASTER_FLOOR="0.03",
    )  # fmt: skip
    values = resolved(done)
    assert values["rate"] == (250.0, "command line")
    assert values["weber"] == (0.1, "command line")
    assert values["passive"] == (False, "command line")
    assert values["codec"] == ("deadband", "HAPTICNET_MASTER_CODEC")
    assert values["floor"] == (0.03, "HAPTICNET_MASTER_FLOOR")
    assert values["real-time"] == (False, f"{rig} [master]")
    assert values["multiplier"] == (1.0, "default")


def test_a_flag_of_the_environment_and_an_own_name_of_a_key(run):
    values = resolved(run("config", "--json", "master", HAPTICNET_MASTER_REAL_TIME="off", HAPTICNET_KEY="mine.toml"))
    assert values["real-time"] == (False, "HAPTICNET_MASTER_REAL_TIME")
    assert values["key"] == ("mine.toml", "HAPTICNET_KEY")


def test_a_list_and_a_verb_of_two_words(run, rig):
    values = resolved(run("config", "--json", "slave", HAPTICNET_CONFIG=str(rig)))
    assert values["add-codec"] == (["a.py:One", "b.py:Two"], f"{rig} [slave]")
    values = resolved(run("config", "--config", rig, "--json", "device", "step"))
    assert values["from"] == (0.7, f"{rig} [device.step]")


def test_without_a_verb_everything_that_is_set_is_listed(run, rig):
    done = run("config", "--config", rig, HAPTICNET_SLAVE_SEED="4")
    lines = [line.split() for line in done.stdout.splitlines()]
    assert ["master", "--codec", "raw", str(rig), "[master]"] in lines
    assert ["slave", "--seed", "4", "HAPTICNET_SLAVE_SEED"] in lines
    assert ["master", "--passive", "yes", str(rig), "[master]"] in lines
    assert len(lines) == 7
    assert "neither a file nor the environment" in run("config").stdout
    shared = [line.split() for line in run("config", HAPTICNET_KEY="mine.toml").stdout.splitlines()]
    assert ["slave", "--key", "mine.toml", "HAPTICNET_KEY"] in shared


def test_what_a_file_sets_reaches_the_verb(run, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("[scene.show]\njson = true\n")
    assert json.loads(run("scene", "show", "--config", path).stdout)["name"].startswith("paper")
    assert json.loads(run("scene", "show", HAPTICNET_SCENE_SHOW_JSON="yes").stdout)["name"].startswith("paper")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[master]\ncodex = 'raw'\n", ("[master]", "unknown key 'codex'", "did you mean 'codec'?")),
        ("[mastr]\ncodec = 'raw'\n", ("unknown table [mastr]", "'master'")),
        ("master = 3\n", ("master is a command", "[master]")),
        ("[master]\nreal-time = 'no'\n", ("real-time is 'no'", "true or false")),
        ("[master]\ncodec = true\n", ("codec is True", "text in quotes or a number")),
        ("[slave]\nadd-codec = 'a.py:One'\n", ("add-codec is 'a.py:One'", "it must be a list")),
        ("[master]\nconfig = 'other.toml'\n", ("unknown key 'config'",)),
        ('[master]\ncodec = "\\u001b]0;title\\u0007"\n', ("'codec' has the control character U+001B",)),
    ],
)
def test_a_wrong_file_is_one_line_whatever_the_verb(run, tmp_path, text, words):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    for verb in (("config",), ("codecs",)):
        done = run(*verb, "--config", path)
        assert done.returncode in (2, 3)
        assert done.stdout == ""
        (line,) = done.stderr.splitlines()
        assert str(path) in line
        for word in words:
            assert word in line


def test_an_invalid_value_is_told_with_the_place_it_comes_from(run, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("[slave]\ndrain = 'long'\n")
    done = run("slave", "--listen", "127.0.0.1:0", "--config", path)
    assert done.returncode == 2
    assert f"{path} [slave]: " in done.stderr
    done = run("slave", "--listen", "127.0.0.1:0", HAPTICNET_SLAVE_DRAIN="long")
    assert "HAPTICNET_SLAVE_DRAIN: " in done.stderr
    assert "Traceback" not in done.stderr
    done = run("codecs", HAPTICNET_CODECS_JSON="maybe")
    assert (
        done.stderr
        == "hapticnet: HAPTICNET_CODECS_JSON is 'maybe'; it must be one of 1, true, yes, on, 0, false, no, off\n"
    )


def test_a_misspelt_variable_is_a_warning_because_other_programs_set_some_too(run):
    done = run("codecs", HAPTICNET_CODECS_JSN="1", HAPTICNET_CODECS_PORT="tcp://10.0.0.1:80")
    assert done.returncode == 0
    assert "HAPTICNET_CODECS_JSN is ignored" in done.stderr
    assert "did you mean 'HAPTICNET_CODECS_JSON'?" in done.stderr
    assert done.stderr.count("codecs: warning: ") == 2
    assert run("scene", "show", HAPTICNET_CODECS_JSN="1").stderr == "", "it concerns another verb"


def test_config_warns_of_every_variable_that_sets_nothing(run):
    for words in ((), ("master",)):
        done = run("config", *words, HAPTICNET_MASTR_CODEC="raw", HAPTICNET_SLAVE_PORT="1", HAPTICNET_KEY="mine.toml")
        assert done.returncode == 0
        told = [line.partition("the environment variable ")[2] for line in done.stderr.splitlines()]
        end = "is ignored: no verb has such an option"
        assert told == [
            f"HAPTICNET_MASTR_CODEC {end} (did you mean 'HAPTICNET_MASTER_CODEC'?)",
            f"HAPTICNET_SLAVE_PORT {end} (did you mean 'HAPTICNET_SLAVE_REPORT'?)",
        ]
        assert done.stderr.startswith("config: warning: ")


def test_a_size_is_shown_as_one_writes_it(run):
    assert re.search(r"^--record-limit +2GiB +default$", run("config", "master").stdout, re.MULTILINE)


def test_nothing_in_the_environment_speaks_to_the_terminal(run):
    done = run("config", "master", HAPTICNET_MASTER_CODEC="\x1b]0;title\x07")
    assert "?]0;title?" in done.stdout + done.stderr
    assert all(line.isprintable() for line in (done.stdout + done.stderr).splitlines())


def test_of_a_long_value_the_middle_is_left_out(run):
    done = run("slave", HAPTICNET_SLAVE_DURATION="A" * 100_000)
    assert done.returncode == 2
    assert len(done.stderr) < 5000
    assert "HAPTICNET_SLAVE_DURATION" in done.stderr
    assert done.stderr.rstrip().endswith("(see hapticnet slave --help)")


@pytest.mark.parametrize("columns", ["0", "00"])
def test_a_terminal_without_columns_is_taken_for_one_of_unknown_width(run, columns):
    assert "Timer" in run("doctor", "--quick", COLUMNS=columns).stdout
