"""Keys and files are found, and their faults told, from Python as on the command line."""

import re
import shutil

import pytest

import hapticnet as hn
from hapticnet.recordings.session.reading import read_session
from tests.cli.test_cli_trust import make_key
from tests.ready import hapticnet

ANYWHERE = "0.0.0.0:0"
ELSEWHERE = "192.0.2.1:47800"  # RFC 5737: never assigned, so nothing is reached
OPEN = "127.0.0.1:0"
FORCE = "t_s,force_n\n0,1\n0.001,2\n"
SPRING = """
class Spring:
    def step(self, sample):
        return 100.0 * sample.position_m[0]

    def close(self):
        raise OSError("the arm is gone")
"""


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """Return the home folder of this user, who works in another folder."""
    for name in ("HAPTICNET_KEY", "HAPTICNET_MASTERS", "HAPTICNET_PEER_KEY", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "home").mkdir()
    (tmp_path / "work").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path / "work")
    yield tmp_path / "home"
    assert not (tmp_path / "work" / "~").exists()


def said_by_command(*arguments):
    """Return the error of a command, without what stands before every line."""
    return hapticnet(*arguments).stderr.strip().splitlines()[-1].partition("hapticnet: ")[2]


def said_in_python(make, *arguments, **parameters):
    with pytest.raises(hn.HapticnetError) as error:
        make(*arguments, **parameters).__enter__()
    return str(error.value)


def as_options(parameters):
    for name, value in parameters.items():
        option = "--" + name.replace("_", "-")
        yield from [option] if value is True else [option, value]


def as_parameters(text):
    for name in ("peer_key", "insecure", "key", "masters"):
        text = text.replace("--" + name.replace("_", "-"), name)
    return text


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, ("--peer-key", "hapticnet key public", "--insecure")),
        ({"peer_key": "abc"}, ("--peer-key is 'abc'",)),
        ({"peer_key": "PEER"}, ("hapticnet key new ",)),
        ({"key": "other.toml"}, ("--key needs --peer-key",)),
        ({"key": "~/missing.toml", "peer_key": "PEER"}, ("missing.toml",)),
        ({"peer_key": "PEER", "insecure": True}, ("--insecure", "--peer-key", "omit one")),
    ],
)
def test_what_a_master_lacks_is_said_in_the_same_words(parameters, words):
    peer = make_key("other.toml")
    parameters = {name: peer if value == "PEER" else value for name, value in parameters.items()}
    by_command = said_by_command("master", "--connect", ELSEWHERE, *as_options(parameters))
    assert all(word in by_command for word in words)
    assert said_in_python(hn.ThreadedMaster, ELSEWHERE, **parameters) == as_parameters(by_command) != ""


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, ("hapticnet key new", "list the masters in ", "--insecure")),
        ({"key": "other.toml"}, ("masters.toml", "does not exist", "[[master]]")),
        ({"key": "~/missing.toml"}, ("missing.toml",)),
        ({"masters": "none.toml"}, ()),
    ],
)
def test_what_a_slave_lacks_is_said_in_the_same_words(parameters, words):
    make_key("other.toml")
    by_command = said_by_command("slave", "--listen", ANYWHERE, *as_options(parameters))
    assert all(word in by_command for word in words)
    in_python = said_in_python(hn.ThreadedSlave, listen=ANYWHERE, **parameters)
    port = r"(?<=0\.0\.0\.0:)\d+"
    assert re.sub(port, "", in_python) == re.sub(port, "", as_parameters(by_command)) != ""


def test_keys_are_found_where_the_command_makes_them(home):
    public = hapticnet("key", "new").stdout.strip()
    kept = home / ".config" / "hapticnet"
    entry = hapticnet("key", "new", home / "master.toml").stderr.partition("[[master]]")
    (kept / "masters.toml").write_text(entry[1] + entry[2] + 'scene = "paper:5"\n')
    with hn.ThreadedSlave(listen=OPEN, key="~/.config/hapticnet/key.toml") as slave:
        shutil.move(home / "master.toml", kept / "key.toml")  # as if this were the master's host
        with hn.ThreadedMaster(slave.address, peer_key=public) as master:
            assert master.report()["sealed"]
            assert master.scene == "paper:5", "the list names the scene"


def test_a_list_is_checked_as_the_command_checks_it(home):
    own = make_key(home / "key.toml")
    (home / "masters.toml").write_text(f'[[master]]\nname = "me"\npublic = "{own}"\n')
    assert "is the slave's own" in said_in_python(hn.ThreadedSlave, listen=OPEN, key="~/key.toml")


def test_a_tilde_is_the_home_folder_in_python_and_an_object_from_a_file_is_closed(home, caplog):
    (home / "spring.py").write_text(SPRING)
    (home / "force.csv").write_text(FORCE)
    assert len(hn.load_recording("~/force.csv").force) == 2
    with (
        hn.ThreadedSlave("~/spring.py:Spring", listen=OPEN) as slave,
        hn.ThreadedMaster(slave.address, record="~/run.csv") as master,
    ):
        master.exchange(0.0)
    assert "the arm is gone" in caplog.text
    assert read_session(home / "run.csv").complete
    with hn.ThreadedSlave("recording:~/force.csv", listen=OPEN):
        pass
    assert str(home / "none.toml") in said_in_python(hn.ThreadedSlave, "~/none.toml", listen=OPEN)
    assert str(home / "none.toml") in said_in_python(hn.ThreadedMaster, profile="~/none.toml", device="sim")


def test_a_tilde_that_the_shell_leaves_is_the_home_folder_on_the_command_line(home):
    """As in --key=~/key.toml and trace:~/hand.csv, and in files and variables."""
    (home / "force.csv").write_text(FORCE)
    assert hapticnet("compare", "~/force.csv", "--codecs", "raw", "--csv=~/rows.csv").returncode == 0
    assert (home / "rows.csv").exists()
    assert hapticnet("key", "new", "~/new/key.toml").returncode == 0
    assert (home / "new" / "key.toml").exists()
    for arguments in (
        ("slave", "--scene", "recording:~/none.csv"),
        ("master", "--operator", "trace:~/none.csv"),
        ("master", "--profile=~/none.csv"),
        ("master", "--config=~/none.csv"),
    ):
        assert str(home / "none.csv") in hapticnet(*arguments).stderr


def test_a_name_that_only_begins_with_a_tilde_stays(tmp_path):
    (tmp_path / "work" / "~nobody-has-this-name.csv").write_text(FORCE)
    assert len(hn.load_recording("~nobody-has-this-name.csv").force) == 2
