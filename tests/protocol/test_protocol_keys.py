import os
import stat
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import FileError, SettingsError
from hapticnet.protocol import key_files
from hapticnet.protocol.key_files import dump_master, load_key, load_roster, write_key
from hapticnet.protocol.keys import (
    NO_PSK,
    MasterEntry,
    MasterKey,
    PrivateKey,
    Roster,
    check_public,
    format_key,
    new_key,
    parse_key,
)

# RFC 7748 §6.1.
ALICE = bytes.fromhex("77076d0a7318a57d3c16c17251b26645df4c2f87ebc0992ab177fba51db92c2a")
ALICE_PUBLIC = bytes.fromhex("8520f0098930a754748b7ddcb43ef75a0dbf3a0d26381af4eba4a98eaa9b4e6a")
BOB_PUBLIC = bytes.fromhex("de9edb7d7b7dc1b4d35b61c2ece435373f8343c85b78674dadfc7e146f882b4f")
PSK = bytes(range(32))

ALICE_TEXT, PUBLIC_TEXT, PSK_TEXT = format_key(ALICE), format_key(ALICE_PUBLIC), format_key(PSK)
ENTRY = f'[[master]]\nname = "finger"\npublic = "{PUBLIC_TEXT}"\n'


def private_file(path, text, mode=0o600):
    path.write_text(text)
    path.chmod(mode)
    return path


def message_of(kind, function, *arguments):
    with pytest.raises(kind) as caught:
        function(*arguments)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_public_key_is_the_one_of_the_rfc():
    assert PrivateKey(ALICE).public == ALICE_PUBLIC


@given(st.binary(min_size=32, max_size=32))
def test_a_key_is_read_back_from_its_text(key):
    text = format_key(key)
    assert len(text) == 44
    assert parse_key(f" {text}\n", "public") == key


@given(st.text(max_size=43) | st.text(min_size=45, max_size=60))
def test_a_text_that_is_not_a_key_is_refused_in_one_line(text):
    message = message_of(SettingsError, parse_key, text, "public")
    assert message.startswith("public is ")
    assert "44 characters of base64" in message


@pytest.mark.parametrize(
    "text",
    [
        PUBLIC_TEXT[:-2] + "p=",  # the last character's two unused bits are not zero
        PUBLIC_TEXT.replace("/", "_") if "/" in PUBLIC_TEXT else "_" + PUBLIC_TEXT[1:],
        "é" * 44,
        PUBLIC_TEXT[:20] + " " + PUBLIC_TEXT[21:],
    ],
)
def test_a_key_has_one_spelling(text):
    assert "public is " in message_of(SettingsError, parse_key, text, "public")


def test_a_mistake_in_a_secret_does_not_show_the_secret():
    with pytest.raises(SettingsError) as caught:
        parse_key(ALICE_TEXT[:-1], "private", secret=True)
    assert "private has 43 characters" in str(caught.value)
    assert ALICE_TEXT[:8] not in str(caught.value)


def test_secrets_are_not_in_the_representation_of_what_holds_them():
    key = PrivateKey(ALICE, PSK)
    entry = MasterEntry(name="finger", public=ALICE_PUBLIC, psk=PSK)
    for text in (repr(key), repr(MasterKey(key, BOB_PUBLIC)), repr(entry)):
        assert repr(ALICE)[2:-1] not in text
        assert repr(PSK)[2:-1] not in text


def test_new_keys_differ_and_come_from_the_generator_alone():
    one, same = (new_key(np.random.default_rng(1)) for _ in range(2))
    assert one == same
    assert new_key(np.random.default_rng(2)) != one
    assert one.psk == NO_PSK


def test_a_key_of_another_length_is_refused():
    assert "private has 31 bytes" in message_of(SettingsError, PrivateKey, bytes(31))
    assert "psk has 33 bytes" in message_of(SettingsError, PrivateKey, ALICE, bytes(33))
    assert "has 5 bytes" in message_of(SettingsError, check_public, "public", bytes(5))


@pytest.mark.parametrize("point", [0, 1, 2**255 - 19 - 1])
def test_a_public_key_that_gives_everybody_the_same_secret_is_refused(point):
    public = point.to_bytes(32, "little")
    assert "is not a public key" in message_of(SettingsError, check_public, "public", public)
    assert "is not a public key" in message_of(SettingsError, MasterKey, PrivateKey(ALICE), public)


def test_a_master_is_not_given_its_own_key_as_the_slaves():
    message = message_of(SettingsError, MasterKey, PrivateKey(ALICE), ALICE_PUBLIC)
    assert "hapticnet key public" in message


def test_a_roster_finds_masters_by_public_key():
    masters = [MasterEntry(name="a", public=ALICE_PUBLIC), MasterEntry(name="b", public=BOB_PUBLIC)]
    roster = Roster(masters)
    assert [roster.find(ALICE_PUBLIC), roster.find(BOB_PUBLIC), roster.find(bytes(32))] == [*masters, None]
    assert list(roster) == masters
    assert len(roster) == 2
    assert len(Roster()) == 0


def test_a_roster_refuses_the_same_master_twice():
    one = MasterEntry(name="a", public=ALICE_PUBLIC)
    same_key = MasterEntry(name="b", public=ALICE_PUBLIC)
    same_name = MasterEntry(name="a", public=BOB_PUBLIC)
    assert "master 2: public is that of 'a' too" in message_of(SettingsError, Roster, [one, same_key])
    assert "master 2: name 'a' is taken" in message_of(SettingsError, Roster, [one, same_name])


def test_a_written_key_is_read_back_and_only_its_owner_can_read_it(tmp_path):
    path = tmp_path / "new" / "key.toml"
    before = os.umask(0)
    try:
        write_key(path, PrivateKey(ALICE, PSK))
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert load_key(path) == PrivateKey(ALICE, PSK)


def test_a_key_file_has_its_final_mode_before_its_first_byte(tmp_path, monkeypatch):
    path, modes = tmp_path / "key.toml", []
    monkeypatch.setattr(os, "fsync", lambda _: None)
    real_open = os.open

    def watched(*arguments, **keywords):
        descriptor = real_open(*arguments, **keywords)
        status = os.fstat(descriptor)
        modes.append((stat.S_IMODE(status.st_mode), status.st_size))
        return descriptor

    monkeypatch.setattr(os, "open", watched)
    write_key(path, PrivateKey(ALICE))
    assert modes == [(0o600, 0)]


def test_a_key_is_never_overwritten_not_even_through_a_link(tmp_path):
    path, link, target = tmp_path / "key.toml", tmp_path / "link.toml", tmp_path / "target.toml"
    path.write_text("kept")
    link.symlink_to(target)
    for taken in (path, link):
        assert "never overwritten" in message_of(FileError, write_key, taken, PrivateKey(ALICE))
    assert path.read_text() == "kept"
    assert not target.exists()


def test_a_key_that_cannot_be_written_leaves_no_file(tmp_path, monkeypatch):
    path = tmp_path / "key.toml"

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert "No space left" in message_of(FileError, write_key, path, PrivateKey(ALICE))
    assert not path.exists()
    path.write_text("")
    assert "cannot create the folder" in message_of(FileError, write_key, path / "key.toml", PrivateKey(ALICE))
    assert "cannot create the folder" in message_of(FileError, write_key, tmp_path / "\0" / "k", PrivateKey(ALICE))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o601])
def test_a_key_that_others_can_access_is_refused_with_the_command_that_corrects_it(tmp_path, mode):
    path = private_file(tmp_path / "my key.toml", f'private = "{ALICE_TEXT}"', mode)
    message = message_of(FileError, load_key, path)
    assert f"mode {mode:04o}" in message
    assert message.endswith(f"run: chmod 600 '{path}'")
    path.chmod(0o400)
    assert load_key(path) == PrivateKey(ALICE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "private is missing"),
        (f'private = "{ALICE_TEXT}"\npublic = "x"', "unknown key 'public'; the keys are private, psk"),
        ("private = 5", "private is invalid; it must be text in quotes"),
        (f"private = {ALICE_TEXT}", "not a TOML file"),
        (f'private = "{ALICE_TEXT[1:]}"', "private has 43 characters; a key is 44 characters of base64"),
        (f'private = "{ALICE_TEXT}"\npsk = "short"', "psk has 5 characters"),
        (f'private = "{ALICE_TEXT}"\npsk = "{format_key(NO_PSK)}"', "psk is all zeros"),
    ],
)
def test_a_bad_key_file_is_refused_in_one_line_that_shows_no_secret(tmp_path, text, words):
    path = private_file(tmp_path / "key.toml", text)
    message = message_of((FileError, SettingsError), load_key, path)
    assert message.startswith(f"{path}: ")
    assert words in message
    assert ALICE_TEXT[5:15] not in message


def test_a_missing_file_says_how_to_make_one(tmp_path):
    path = tmp_path / "key.toml"
    assert message_of(FileError, load_key, path) == (f"{path} does not exist; make it with: hapticnet key new {path}")
    assert "does not exist" in message_of(FileError, load_roster, path)


def test_a_list_gives_each_master_its_limits(tmp_path):
    text = f"""{ENTRY}
[[master]]
name = "theatre 2"
public = "{format_key(BOB_PUBLIC)}"
psk = "{PSK_TEXT}"
scene = "paper:1"
fastest_rate_hz = 500
most_sessions = 2
"""
    roster = load_roster(private_file(tmp_path / "masters.toml", text))
    assert list(roster) == [
        MasterEntry(name="finger", public=ALICE_PUBLIC),
        MasterEntry(
            name="theatre 2", public=BOB_PUBLIC, psk=PSK, scene="paper:1", fastest_rate_hz=500.0, most_sessions=2
        ),
    ]


@pytest.mark.parametrize(("load", "text"), [(load_key, f'private = "{ALICE_TEXT}"'), (load_roster, ENTRY)])
class TestWhoCanChangeIt:
    def test_a_file_of_another_account_is_refused_and_one_of_root_is_not(self, tmp_path, monkeypatch, load, text):
        path = private_file(tmp_path / "a.toml", text)
        there = path.stat()
        monkeypatch.setattr(os, "geteuid", lambda: there.st_uid + 1)
        monkeypatch.setattr(key_files, "ROOT", there.st_uid)
        load(path)
        monkeypatch.setattr(key_files, "ROOT", -1)
        message = message_of(FileError, load, path)
        assert f"belongs to another account (number {there.st_uid})" in message
        assert message.endswith(f"run: sudo chown $USER {path}")

    def test_a_folder_that_all_can_change_is_refused_also_behind_a_link(self, tmp_path, load, text):
        for name in ("open", "own"):
            (tmp_path / name).mkdir()
        (tmp_path / "open").chmod(0o777)
        there = private_file(tmp_path / "open" / "a.toml", text)
        (tmp_path / "own" / "to.toml").symlink_to(there)
        own = private_file(tmp_path / "own" / "a.toml", text)
        (tmp_path / "open" / "to.toml").symlink_to(own)
        load(own)
        for path in (there, tmp_path / "own" / "to.toml", tmp_path / "open" / "to.toml"):
            assert message_of(FileError, load, path).endswith(f"run: chmod o-w {tmp_path / 'open'}")
        (tmp_path / "open").chmod(0o1777)  # as /tmp: nobody can replace a file of another
        load(there)


def test_an_empty_list_admits_nobody(tmp_path):
    assert len(load_roster(private_file(tmp_path / "masters.toml", "", 0o644))) == 0


def test_a_list_may_be_read_by_others_unless_it_holds_a_secret(tmp_path):
    path = private_file(tmp_path / "masters.toml", ENTRY, 0o644)
    assert len(load_roster(path)) == 1
    for mode in (0o646, 0o664):
        path.chmod(mode)
        assert message_of(FileError, load_roster, path).endswith(f"(mode {mode:04o}); run: chmod go-w {path}")
    private_file(path, f'{ENTRY}psk = "{PSK_TEXT}"', 0o644)
    assert message_of(FileError, load_roster, path).endswith(f"run: chmod 600 {path}")
    path.chmod(0o600)
    assert next(iter(load_roster(path))).psk == PSK


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[master]]\nname = "a"', "master 1: public is missing"),
        (f'{ENTRY}[[master]]\nname = "b"\npublic = "abc"', "master 2: public is 'abc' (3 characters)"),
        (f"{ENTRY}scenes = 1", "master 1: unknown key 'scenes' (did you mean 'scene'?); the keys are name,"),
        (f'{ENTRY}psk = "{PSK_TEXT[:9]}"', "master 1: psk has 9 characters"),
        (f"{ENTRY}fastest_rate_hz = 5", "master 1: fastest_rate_hz is 5.0 Hz; it must be between 20"),
        (f"{ENTRY}fastest_rate_hz = true", "master 1: fastest_rate_hz is True; it must be a number"),
        (f"{ENTRY}most_sessions = 0", "master 1: most_sessions is 0; it must be between 1"),
        (f"{ENTRY}most_sessions = 1.5", "master 1: most_sessions is 1.5"),
        (f'{ENTRY}scene = ""', "master 1: scene is empty"),
        (ENTRY.replace("finger", ""), "master 1: name is ''"),
        (ENTRY.replace("finger", "ü" * 33), "1 to 64 printable bytes"),
        (ENTRY + ENTRY, "master 2: public is that of 'finger' too"),
        (ENTRY.replace(PUBLIC_TEXT, format_key(bytes(32))), "is not a public key"),
        ("master = 5", "master is 5; it must be a list"),
        (ENTRY.replace("[[master]]", "[master]"), "[master] is one table; write [[master]], with two brackets"),
        (ENTRY.replace("[[master]]", "[[masters]]"), "unknown key 'masters' (did you mean 'master'?);"),
    ],
)
def test_a_bad_list_is_refused_in_one_line(tmp_path, text, words):
    path = private_file(tmp_path / "masters.toml", text)
    message = message_of((FileError, SettingsError), load_roster, path)
    assert message.startswith(f"{path}: ")
    assert words in message


def test_a_master_is_written_as_the_table_it_is_read_from(tmp_path):
    entry = MasterEntry(name='the "finger"', public=ALICE_PUBLIC, scene="paper", fastest_rate_hz=1000.0)
    text = dump_master(entry)
    assert list(load_roster(private_file(tmp_path / "masters.toml", text))) == [entry]
    secret = MasterEntry(name="finger", public=ALICE_PUBLIC, psk=PSK)
    assert "psk" not in tomllib.loads(dump_master(secret))["master"][0]


@pytest.mark.parametrize("load", [load_key, load_roster])
def test_a_name_that_no_file_can_have_is_refused_in_one_line(tmp_path, load):
    assert message_of(FileError, load, tmp_path / ("x" * 300)).endswith("File name too long")
