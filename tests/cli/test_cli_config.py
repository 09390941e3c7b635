"""Options come from the command line, the environment and a file, in this order; what is misspelt is told."""

import json

import pytest


@pytest.fixture
def force(tmp_path):
    path = tmp_path / "force.csv"
    path.write_text("t_s,force_n\n" + "".join(f"{n / 1000},{n / 100}\n" for n in range(50)))
    return path


def test_the_command_line_precedes_the_environment_which_precedes_the_file(run, force, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text('[compare]\ncodecs = "deadband"\nweber = 0.2\nfloor = 0.01\nmultipliers = "2"\njson = true\n')
    done = run(
        "compare", force, "--config", path, "--weber", "0.1", HAPTICNET_COMPARE_WEBER="0.3",
        HAPTICNET_COMPARE_FLOOR="0.03",
    )  # fmt: skip
    settings = json.loads(done.stdout)["settings"]
    assert settings == {
        "seed": 1, "weber_fraction": [0.1], "floor_n": [0.03], "multiplier": [2.0], "loss": 0.0, "delay_us": 25_000,
    }  # fmt: skip
    done = run("compare", force, "--no-json", HAPTICNET_CONFIG=str(path))
    assert "threshold 2 JND" in done.stdout, "a flag can be switched off again"


def test_a_list_and_a_verb_of_two_words(run, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text('[slave]\nadd-codec = ["raw", "no.py:Two"]\n[device.step]\nto = 0.4\n')
    done = run("slave", "--listen", "127.0.0.1:0", "--config", path)
    assert f"{path} [slave]: " in done.stderr
    assert "codec no.py:Two: cannot find no.py" in done.stderr
    assert "forces must differ" in run("device", "step", "--config", path).stderr


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
    done = run("codecs", "--config", path)
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


def test_nothing_in_the_environment_speaks_to_the_terminal(run):
    done = run("codecs", HAPTICNET_CODECS_JSON="\x1b]0;title\x07")
    assert "]0;title" in done.stderr
    assert all(line.isprintable() for line in done.stderr.splitlines())


@pytest.mark.parametrize("columns", ["0", "00"])
def test_a_terminal_without_columns_is_taken_for_one_of_unknown_width(run, columns):
    assert "Timer" in run("doctor", "--quick", COLUMNS=columns).stdout
