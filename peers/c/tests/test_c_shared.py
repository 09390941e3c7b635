"""The shared library, which bindings load, and the key files that it reads."""

import base64
import ctypes
import os
import re
import subprocess
from pathlib import Path

import pytest

import peer
from hapticnet.perception import WeberLaw
from hapticnet.protocol.key_files import dump_master, write_key
from hapticnet.protocol.keys import MasterEntry, PrivateKey, format_key
from tests.peers import MASTER, PSK, SLAVE

DECLARED = re.compile(r"^(?!typedef)[a-z][\w ]*?[ *](hn_\w+)\(", re.MULTILINE)
HEADERS = ("include/hapticnet.h", "sealed/hapticnet_sealed.h", "sealed/hapticnet_keys.h", "shared/hapticnet_binding.h")


@pytest.fixture(scope="module")
def shared(build_folder):
    lib = ctypes.CDLL(str(peer.build("shared", build_folder) / "libhapticnet.so"))
    for name in ("hn_make_master", "hn_make_slave"):
        getattr(lib, name).restype = ctypes.c_void_p
    for name in ("hn_seal_master", "hn_seal_slave", "hn_read_key", "hn_read_masters", "hn_codec_name"):
        getattr(lib, name).restype = ctypes.c_char_p
    lib.hn_parse_key.restype = ctypes.c_bool
    return lib


def symbols(library):
    listed = subprocess.check_output(["nm", "-D", "--defined-only", library], text=True)
    return {line.split()[-1] for line in listed.splitlines()}


def declared(*headers):
    return {name for header in headers for name in DECLARED.findall((peer.HERE / header).read_text())}


def make_master(lib, codec=b"deadband", **numbers):
    """Return None if a master is made, or what is wrong."""
    wrong = ctypes.create_string_buffer(lib.hn_error_bytes())
    names = (ctypes.c_char_p * len(numbers))(*(name.encode() for name in numbers))
    values = (ctypes.c_double * len(numbers))(*numbers.values())
    entropy = peer.Entropy(lambda _: 7)
    made = lib.hn_make_master(codec, b"a", names, values, ctypes.c_size_t(len(numbers)), entropy, None, wrong)
    if made:
        lib.hn_free_master(ctypes.c_void_p(made))
    return None if made else wrong.value.decode()


def read_key(lib, path):
    """Return the private key and the shared one in a file, or what is wrong with it."""
    private, psk, text = (ctypes.create_string_buffer(size) for size in (32, 32, lib.hn_error_bytes()))
    wrong = lib.hn_read_key(str(path).encode(), private, psk, text)
    return wrong.decode() if wrong is not None else (private.raw, psk.raw)


def read_masters(lib, path, most=8):
    listed, text, count = (
        ctypes.create_string_buffer(64 * most),
        ctypes.create_string_buffer(lib.hn_error_bytes()),
        ctypes.c_size_t(),
    )
    wrong = lib.hn_read_masters(str(path).encode(), listed, ctypes.c_size_t(most), ctypes.byref(count), text)
    return wrong.decode() if wrong is not None else [listed.raw[64 * i : 64 * i + 64] for i in range(count.value)]


def written(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def test_what_the_headers_declare_is_visible_and_nothing_else(build_folder):
    assert symbols(peer.build("shared", build_folder) / "libhapticnet.so") == declared(*HEADERS)


def test_without_libcrypto_the_library_says_so(tmp_path):
    lib = ctypes.CDLL(str(peer.build("shared", tmp_path, "SEALED=") / "libhapticnet.so"))
    assert symbols(tmp_path / "libhapticnet.so") == declared(HEADERS[0], HEADERS[3])
    lib.hn_read_key.restype = ctypes.c_char_p
    assert b"without libcrypto" in lib.hn_read_key(None, None, None, None)


def test_a_master_is_made_by_the_names_of_its_numbers(shared):
    assert make_master(shared) is None
    assert make_master(shared, rate_hz=500.0, axes=3.0, step_n=0.01, multiplier=2.0) is None


WRONG = {
    "rate_hz is 5; it must be between 20 and 100000": {"rate_hz": 5.0},
    "rate_hz is nan; it must be between 20 and 100000": {"rate_hz": float("nan")},
    "axes is 4; it must be 1 to 3": {"axes": 4.0},
    "weber_fraction is 2; it must be 0 or between 1e-12 and 1": {"weber_fraction": 2.0},
    "floor_n is -1; it must be 0 or between 1e-12 and 1e+09": {"floor_n": -1.0},
    "multiplier is 1e-13; it must be 0 or between 1e-12 and 1000": {"multiplier": 1e-13},
    "position_share is 1; it must be 0 or between 0.01 and 0.9": {"position_share": 1.0},
    "step_n is 2; it must be 0 or between 1e-12 and 1": {"step_n": 2.0},
    "parameter is 'stepn'; it must be one of deadband's: step_n": {"step_n": 0.5, "stepn": 0.01},
    f"parameter is '{'p' * 128}'; it must be one of deadband's: step_n": {"p" * 999: 0.01},
    "parameters has 7 entries; a codec has at most 5": {f"p{i}": 0.0 for i in range(7)},
}


@pytest.mark.parametrize("said", WRONG)
def test_an_error_states_the_value_seen_and_what_would_be_right(shared, said):
    assert make_master(shared, **WRONG[said]) == said


def test_an_unknown_codec_is_refused_with_the_names_of_all(shared):
    said = make_master(shared, codec=b"lossless")
    names = [shared.hn_codec_name(i).decode() for i in range(13)]
    assert shared.hn_codec_name(13) is None
    assert said == f"codec is 'lossless'; it must be one of {', '.join(names)}"


def test_its_defaults_are_those_of_hapticnet():
    header = (peer.HERE / "include" / "hapticnet_constants.h").read_text()
    law = WeberLaw()
    said = re.findall(r"HN_DEFAULT_(?:WEBER_FRACTION|FLOOR_N|MULTIPLIER) (\S+)", header)
    assert [float(value) for value in said] == [law.weber_fraction, law.floor_n, law.multiplier]


def test_the_scene_of_a_slave_must_have_a_name_that_its_master_takes(shared):
    wrong = ctypes.create_string_buffer(shared.hn_error_bytes())
    entropy = peer.Entropy(lambda _: 7)
    for scene, axes in ((b"x" * 65, 1), (b"a\nb", 1), (b"spring", 0), (b"spring", 4)):
        assert not shared.hn_make_slave(scene, axes, entropy, None, wrong)
        seen = f"axes is {axes}" if scene == b"spring" else f"scene is '{scene.decode()}'"
        assert wrong.value.decode().startswith(f"{seen}; it must be ")
    made = shared.hn_make_slave(b"spring", 3, entropy, None, wrong)
    assert made
    assert shared.hn_seal_slave(ctypes.c_void_p(made), SLAVE.private, MASTER.public + PSK, ctypes.c_size_t(1)) is None
    shared.hn_free_slave(ctypes.c_void_p(made))


def test_a_master_is_sealed_once_before_its_first_tick(shared):
    wrong, entropy = ctypes.create_string_buffer(shared.hn_error_bytes()), peer.Entropy(lambda _: 7)
    for begins in (False, True):
        made = ctypes.c_void_p(
            shared.hn_make_master(b"raw", b"a", None, None, ctypes.c_size_t(0), entropy, None, wrong)
        )
        if begins:
            shared.hn_master_tick(made, None, ctypes.c_int64(0))
        else:
            assert shared.hn_seal_master(made, MASTER.private, SLAVE.public, None) is None
        assert b"once, before" in shared.hn_seal_master(made, MASTER.private, SLAVE.public, None)
        shared.hn_free_master(made)


def test_a_key_is_written_as_hapticnet_writes_it_and_has_one_spelling(shared):
    for key in (MASTER.private, PSK, bytes(32), bytes(range(32)), b"\xff" * 32):
        text, back = ctypes.create_string_buffer(45), ctypes.create_string_buffer(32)
        shared.hn_format_key(text, key)
        assert text.value.decode() == format_key(key)
        assert shared.hn_parse_key(back, text.value)
        assert back.raw == key
    good = format_key(bytes(range(32)))
    for bad in ("", good[:-1], good + "=", good[:-2] + "9=", good[:5] + " " + good[6:], good[:-1] + "A", "é" * 22):
        assert not shared.hn_parse_key(ctypes.create_string_buffer(32), bad.encode())
    public = ctypes.create_string_buffer(32)
    assert shared.hn_derive_public(public, MASTER.private)
    assert public.raw == MASTER.public


def test_a_pipe_a_device_and_an_endless_line_are_refused_at_once(shared, tmp_path):
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    for path in (pipe, link, "/dev/zero", tmp_path):
        assert read_key(shared, path) == f"{path} is not a regular file"
    zeros = written(tmp_path / "zeros", "\0" * 100_000)
    assert "line 1 has a zero byte" in read_key(shared, zeros)
    many = written(tmp_path / "many", "\n" * 100_000)
    assert "more than 20000 lines" in read_masters(shared, many)


def test_the_rest_of_a_long_comment_is_no_line(shared, tmp_path):
    key = f'private = "{format_key(MASTER.private)}"'
    for comment in ("#" * 998 + key, "#" * 999 + key, "#" * 5000 + key):
        assert "more than 998 bytes" in read_key(shared, written(tmp_path / "long.toml", f"{comment}\n"))


def test_a_key_that_is_refused_is_not_given(shared, tmp_path):
    path = written(tmp_path / "open.toml", f'private = "{format_key(MASTER.private)}"\n', 0o644)
    private, psk, text = (ctypes.create_string_buffer(b"\xff" * size, size) for size in (32, 32, 600))
    assert b"chmod 600" in shared.hn_read_key(str(path).encode(), private, psk, text)
    assert (private.raw, psk.raw) == (bytes(32), bytes(32))


def test_a_key_file_of_hapticnet_is_read(shared, tmp_path):
    path = tmp_path / "hapticnet" / "key.toml"
    write_key(path, PrivateKey(MASTER.private, PSK))
    assert read_key(shared, path) == (MASTER.private, PSK)
    plain = tmp_path / "plain.toml"
    write_key(plain, PrivateKey(MASTER.private))
    assert read_key(shared, plain) == (MASTER.private, bytes(32))
    spaced = f"\n# mine\n  private='{format_key(MASTER.private)}'   # secret\n"
    assert read_key(shared, written(tmp_path / "spaced.toml", spaced)) == (MASTER.private, bytes(32))


@pytest.mark.parametrize(
    ("text", "mode", "said"),
    [
        (f'private = "{format_key(PSK)}"', 0o644, "run: chmod 600"),
        ("", 0o600, 'no line: private = "<key>"'),
        ('private = "abc"', 0o600, "private has 3 characters; it must be 44"),
        (f'private = "{format_key(PSK)}"\nprivate = "{format_key(PSK)}"', 0o600, "line 2: private stands there twice"),
        (f'public = "{format_key(PSK)}"', 0o600, "'public' is not known here"),
        ("private: x", 0o600, "line 1 is not understood"),
        (f'private = "{format_key(PSK)}" x', 0o600, "line 1 is not understood"),
        (f'private = "{format_key(PSK)}"\npsk = "{format_key(bytes(32))}"', 0o600, "psk is all zeros"),
    ],
)
def test_a_key_file_that_is_wrong_is_refused_without_showing_the_secret(shared, tmp_path, text, mode, said):
    wrong = read_key(shared, written(tmp_path / "key.toml", text, mode))
    assert said in wrong
    assert format_key(PSK) not in wrong
    assert base64.b64encode(PSK)[:6].decode() not in wrong


def test_a_key_file_that_is_missing_or_lies_in_an_open_folder_is_refused(shared, tmp_path):
    assert "does not exist" in read_key(shared, tmp_path / "no.toml")
    tmp_path.chmod(0o777)
    path = written(tmp_path / "key.toml", f'private = "{format_key(PSK)}"')
    assert "can be replaced by all accounts" in read_key(shared, path)


def test_the_list_of_masters_of_hapticnet_is_read(shared, tmp_path):
    entries = [MasterEntry(name='theatre "2"', public=MASTER.public), MasterEntry(name="b", public=SLAVE.public)]
    text = "".join(map(dump_master, entries)) + f'psk = "{format_key(PSK)}"\n'
    path = written(tmp_path / "masters.toml", text)
    assert read_masters(shared, path) == [MASTER.public + bytes(32), SLAVE.public + PSK]
    assert "more than 1 masters" in read_masters(shared, path, most=1)
    path.chmod(0o640)
    assert "holds a secret" in read_masters(shared, path)
    assert read_masters(shared, written(path, dump_master(entries[0]), 0o644)) == [MASTER.public + bytes(32)]
    assert "chmod go-w" in read_masters(shared, written(path, dump_master(entries[0]), 0o664))
    path.chmod(0o600)
    for more, said in (
        ("fastest_rate_hz = 500.0\n", "not understood"),
        ('scene = "paper"\n', "'scene' is not known here"),
        (dump_master(MasterEntry(name="c", public=MASTER.public)), "same public key"),
        ('[[master]]\nname = "d"\n', "master 2 has no public key"),
    ):
        assert said in read_masters(shared, written(path, dump_master(entries[0]) + more))
