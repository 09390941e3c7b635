"""``hapticnet key``: files that hold secrets, and what is printed of them."""

import stat
import tomllib

import pytest

from hapticnet.protocol.key_files import load_key
from hapticnet.protocol.keys import format_key
from tests.cli.test_cli_errors import assert_one_line
from tests.ready import hapticnet

pytestmark = pytest.mark.usefixtures("home")


def snippet(done):
    """Return the lines of stderr that belong into the slave's list."""
    return done.stderr[done.stderr.index("[[master]]") :]


def test_a_new_key_is_private_and_its_public_key_and_snippet_are_printed(home):
    done = hapticnet("key", "new", "--name", "finger 1")
    assert done.returncode == 0
    path = home / "key.toml"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    key = load_key(path)
    assert done.stdout == format_key(key.public) + "\n"
    assert tomllib.loads(snippet(done)) == {"master": [{"name": "finger 1", "public": format_key(key.public)}]}
    assert format_key(key.private) not in done.stdout + done.stderr
    assert hapticnet("key", "public").stdout == done.stdout


def test_the_key_named_by_the_environment_is_used(tmp_path, monkeypatch):
    monkeypatch.setenv("HAPTICNET_KEY", str(tmp_path / "other.toml"))
    made = hapticnet("key", "new")
    assert (tmp_path / "other.toml").is_file()
    assert hapticnet("key", "public").stdout == made.stdout


def test_a_relative_config_folder_is_ignored_as_its_specification_demands(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert hapticnet("key", "new").returncode == 0
    assert (tmp_path / "home" / ".config" / "hapticnet" / "key.toml").is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("public", "/dev/zero"), "a character device"),
        (("public", "/nowhere/key.toml"), "hapticnet key new /nowhere/key.toml"),
        (("new", "/proc/nowhere/key.toml"), "cannot create the folder"),
        (("new", "/dev/stdout"), "never overwritten"),
        (("new", "key.toml", "--name", "x" * 65), "name is 'xxx"),
    ],
)
def test_files_and_names_that_cannot_be_are_one_line(tmp_path, arguments, words):
    done = hapticnet("key", *arguments, cwd=tmp_path)
    assert_one_line(done, words)
    assert not (tmp_path / "key.toml").exists()
