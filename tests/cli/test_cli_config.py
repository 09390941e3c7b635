"""Options come from the command line and a file, in this order; what is misspelt is told."""

import pytest

SLAVE = ("slave", "--listen", "127.0.0.1:0")


@pytest.fixture
def rig(tmp_path):
    return tmp_path / "rig.toml"


def test_the_command_line_precedes_the_file(run, rig):
    rig.write_text('[slave]\ninsecure = true\nchannel-out = "loss=file"\nadd-codec = ["raw", "no.py:Two"]\n')
    assert f"{rig} [slave]: " in (said := run(*SLAVE, "--config", rig, "--channel-out", "lan").stderr)
    assert "codec no.py:Two: cannot find no.py" in said
    assert "loss=file: " in run(*SLAVE, HAPTICNET_CONFIG=str(rig)).stderr
    said = run(*SLAVE, "--config", rig, "--channel-out", "loss=line").stderr
    assert "loss=line: " in said
    assert str(rig) not in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[master]\ncodex = 'raw'\n", ("[master]", "unknown key 'codex'", "did you mean 'codec'?")),
        ("[mastr]\ncodec = 'raw'\n", ("unknown table [mastr]", "'master'")),
        ("master = 3\n", ("unknown table [master]",)),
        ("[master]\nreal-time = 'no'\n", ("real-time is 'no'", "true or false")),
        ("[master]\ncodec = true\n", ("codec is True", "text in quotes or a number")),
        ("[slave]\nadd-codec = 'a.py:One'\n", ("add-codec is 'a.py:One'", "it must be a list")),
        ("[master]\nconfig = 'other.toml'\n", ("unknown key 'config'",)),
        ("[slave]\ndrain = 'long'\n", (" [slave]: ", "'long' is not a number")),
        ('[slave]\nscene = ""\n', ("[slave] scene is empty; give SCENE, or leave it out",)),
        ('[master]\ncodec = "\\u001b]0;title\\u0007"\n', ("'codec' has the control character U+001B",)),
    ],
)
def test_a_wrong_file_is_one_line(run, rig, text, words):
    rig.write_text(text)
    done = run(*SLAVE, "--config", rig)
    assert done.returncode in (2, 3)
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert str(rig) in line
    for word in words:
        assert word in line


@pytest.mark.parametrize("columns", ["0", "00"])
def test_a_terminal_without_columns_is_taken_for_one_of_unknown_width(run, columns):
    assert "Timer" in run("doctor", "--quick", COLUMNS=columns).stdout
