"""What master and slave refuse before they start: each message says what to do, and no open session is a surprise."""

import pytest

from tests.cli.test_cli_errors import assert_one_line
from tests.ready import hapticnet

ANYWHERE = ("--listen", "0.0.0.0:0")
ELSEWHERE = ("--connect", "192.0.2.1:47800")  # RFC 5737: never assigned, so nothing is reached
pytestmark = pytest.mark.usefixtures("home")


def make_key(path):
    """Make a key file and return the public key."""
    return hapticnet("key", "new", path).stdout.strip()


def listed(public, more=""):
    return f'[[master]]\nname = "finger"\npublic = "{public}"\n{more}'


@pytest.mark.parametrize("address", ["0.0.0.0:0", "[::]:0"])
def test_a_slave_that_other_hosts_can_reach_needs_keys_or_a_word(home, address):
    listing = f"list the masters in {home / 'masters.toml'}"
    assert_one_line(hapticnet("slave", "--listen", address), "hapticnet key new", listing, "--insecure")


def test_a_slave_with_a_key_needs_a_list(home):
    make_key(home / "key.toml")
    assert_one_line(hapticnet("slave", *ANYWHERE), str(home / "masters.toml"), "does not exist", "[[master]]")


def test_a_master_of_another_host_needs_keys_or_a_word():
    assert_one_line(hapticnet("master", *ELSEWHERE), "--peer-key", "hapticnet key public", "--insecure")


def test_a_master_with_half_of_the_keys_is_told_the_other_half(home, tmp_path):
    public = make_key(tmp_path / "other.toml")
    assert_one_line(hapticnet("master", *ELSEWHERE, "--key", tmp_path / "other.toml"), "--key needs --peer-key")
    assert_one_line(hapticnet("master", *ELSEWHERE, "--peer-key", public), f"hapticnet key new {home / 'key.toml'}")


def test_a_master_is_not_asked_for_a_session_that_is_open_and_sealed(tmp_path):
    public = make_key(tmp_path / "key.toml")
    assert_one_line(hapticnet("master", "--insecure", "--peer-key", public), "--insecure", "--peer-key", "omit one")


def test_the_environment_names_keys_as_the_options_do(tmp_path, monkeypatch):
    monkeypatch.setenv("HAPTICNET_KEY", str(tmp_path / "nowhere.toml"))
    assert_one_line(hapticnet("slave"), f"hapticnet key new {tmp_path / 'nowhere.toml'}")
    monkeypatch.setenv("HAPTICNET_PEER_KEY", "abc")
    assert_one_line(hapticnet("master"), "--peer-key is 'abc'")


def test_a_key_that_others_can_read_stops_either_side(tmp_path):
    key, masters = tmp_path / "key.toml", tmp_path / "masters.toml"
    public = make_key(tmp_path / "peer.toml")
    make_key(key)
    masters.write_text(listed(public))
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


def test_a_report_does_not_overwrite_a_key_or_the_list(tmp_path):
    key, masters = tmp_path / "key.toml", tmp_path / "masters.toml"
    public = make_key(tmp_path / "peer.toml")
    make_key(key)
    masters.write_text(listed(public))
    for path in (key, masters):
        done = hapticnet("slave", "--key", key, "--masters", masters, "--report", path)
        assert_one_line(done, str(path), "is an input and would be overwritten")
    done = hapticnet("master", "--key", key, "--peer-key", public, "--report", key)
    assert_one_line(done, "is an input and would be overwritten")


def test_limits_that_cannot_be_are_refused():
    assert_one_line(hapticnet("slave", "--keep", "0.5"), "--keep is 0.5 s; it must be between 1")
