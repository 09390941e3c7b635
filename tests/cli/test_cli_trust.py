"""What master and slave refuse before they start: each message says what to do, and no open session is a surprise."""

import pytest

from tests.cli.test_cli_errors import assert_one_line
from tests.ready import hapticnet

pytestmark = pytest.mark.usefixtures("home")


def make_key(path):
    """Make a key file and return the public key."""
    return hapticnet("key", "new", path).stdout.strip()


def listed(public, more=""):
    return f'[[master]]\nname = "finger"\npublic = "{public}"\n{more}'


@pytest.fixture
def files(tmp_path):
    """Return the key file of a slave, its list with one master, and that master's public key."""
    key, masters, public = tmp_path / "key.toml", tmp_path / "masters.toml", make_key(tmp_path / "peer.toml")
    make_key(key)
    masters.write_text(listed(public))
    return key, masters, public


def test_the_environment_names_keys_as_the_options_do(tmp_path, monkeypatch):
    monkeypatch.setenv("HAPTICNET_KEY", str(tmp_path / "nowhere.toml"))
    assert_one_line(hapticnet("slave"), f"hapticnet key new {tmp_path / 'nowhere.toml'}")
    monkeypatch.setenv("HAPTICNET_PEER_KEY", "abc")
    assert_one_line(hapticnet("master"), "--peer-key is 'abc'")


def test_a_key_that_others_can_read_stops_either_side(files):
    key, _, public = files
    key.chmod(0o644)
    for done in (hapticnet("slave", "--key", key), hapticnet("master", "--key", key, "--peer-key", public)):
        assert_one_line(done, f"run: chmod 600 {key}")


BAD_LISTS = {
    "unknown scene": (lambda _, other: listed(other, 'scene = "moon"'), "master 1: unknown scene 'moon'"),
    "scene file": (lambda _, other: listed(other, 'scene = "tissue.toml"'), "tissue.toml: No such file"),
    "slave's own": (lambda own, _: listed(own), "master 1: public is the slave's own"),
}


@pytest.mark.parametrize("case", BAD_LISTS)
def test_a_list_that_cannot_be_used_stops_the_slave(tmp_path, case):
    make, words = BAD_LISTS[case]
    masters = tmp_path / "list" / "masters.toml"
    own, other = make_key(tmp_path / "key.toml"), make_key(masters.parent / "other.toml")
    masters.write_text(make(own, other))
    done = hapticnet("slave", "--key", tmp_path / "key.toml", "--masters", masters)
    assert_one_line(done, str(masters.parent), words)


def test_a_report_does_not_overwrite_a_key_or_the_list(files):
    key, masters, public = files
    for path in (key, masters):
        done = hapticnet("slave", "--key", key, "--masters", masters, "--report", path)
        assert_one_line(done, str(path), "is an input and would be overwritten")
    done = hapticnet("master", "--key", key, "--peer-key", public, "--report", key)
    assert_one_line(done, "is an input and would be overwritten")


def test_limits_that_cannot_be_are_refused():
    assert_one_line(hapticnet("slave", "--keep", "0.5"), "--keep is 0.5 s; it must be between 1")
