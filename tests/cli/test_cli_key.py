"""``hapticnet key``: files that hold secrets, and what is printed of them."""

import json
import stat
import tomllib

import pytest

from hapticnet.protocol.key_files import load_key
from hapticnet.protocol.keys import format_key
from tests.cli.test_cli_errors import assert_one_line
from tests.ready import hapticnet

pytestmark = pytest.mark.usefixtures("home")
PSK = format_key(bytes(range(32)))


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


def test_list_shows_the_masters_and_their_limits_but_no_secret(home, tmp_path, monkeypatch):
    made = [hapticnet("key", "new", tmp_path / f"{name}.toml", "--name", name) for name in ("one", "two")]
    limits = f'psk = "{PSK}"\nscene = "paper:1"\nfastest_rate_hz = 500\nmost_sessions = 2\n'
    home.mkdir(parents=True)
    masters = home / "masters.toml"
    masters.write_text(snippet(made[0]) + snippet(made[1]) + limits)
    masters.chmod(0o600)
    public = [done.stdout.strip() for done in made]
    shown = hapticnet("key", "list")
    heads, *rows = shown.stdout.splitlines()
    assert heads.split() == ["name", "public", "psk", "scene", "fastest_rate_hz", "most_sessions"]
    assert [row.split() for row in rows] == [
        ["one", public[0], "no", "–", "–", "–"],
        ["two", public[1], "yes", "paper:1", "500", "2"],
    ]
    monkeypatch.setenv("HAPTICNET_KEY", str(home / "key.toml"))  # the list is beside the key
    as_json = hapticnet("key", "list", "--json")
    report = json.loads(as_json.stdout)
    assert report["file"] == str(masters)
    limits = {"scene": "paper:1", "fastest_rate_hz": 500.0, "most_sessions": 2}
    assert report["masters"][1] == {"name": "two", "public": public[1], "psk": True, **limits}
    assert PSK not in shown.stdout + shown.stderr + as_json.stdout + as_json.stderr


def test_an_empty_list_says_how_to_add_a_master(tmp_path):
    (tmp_path / "masters.toml").write_text("")
    done = hapticnet("key", "list", tmp_path / "masters.toml")
    assert done.returncode == 0
    assert "hapticnet key new" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("public", "/dev/zero"), "a character device"),
        (("public", "/nowhere/key.toml"), "hapticnet key new /nowhere/key.toml"),
        (("list", "/nowhere/masters.toml"), "'hapticnet key new'"),
        (("new", "/proc/nowhere/key.toml"), "cannot create the folder"),
        (("new", "/dev/stdout"), "never overwritten"),
        (("new", "key.toml", "--name", "x" * 65), "name is 'xxx"),
    ],
)
def test_files_and_names_that_cannot_be_are_one_line(tmp_path, arguments, words):
    done = hapticnet("key", *arguments, cwd=tmp_path)
    assert_one_line(done, words)
    assert not (tmp_path / "key.toml").exists()
