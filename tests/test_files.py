"""Results are written completely or not at all, and only bounded regular files are read."""

import os
from pathlib import Path

import pytest

from hapticnet.documents import read_document
from hapticnet.errors import FileError, SettingsError
from hapticnet.files import (
    check_readable,
    check_replaceable,
    fresh_path,
    locked,
    open_in_place,
    open_regular,
    parse_bytes,
    read_bytes,
    read_text,
    replacing,
    replacing_bytes,
)


def test_a_file_replaces_the_old_one_and_keeps_its_permissions(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    file.chmod(0o640)
    with replacing(file) as stream:
        stream.write("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new"
    assert file.stat().st_mode & 0o777 == 0o640
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_fails_leaves_the_old_file(tmp_path, failure):
    file = tmp_path / "a.txt"
    file.write_text("old")

    def write_half():
        with replacing(file) as stream:
            stream.write("half")
            raise failure

    with pytest.raises(FileError if isinstance(failure, OSError) else KeyboardInterrupt):
        write_half()
    assert file.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


def test_a_link_in_the_place_of_a_file_of_the_programs_own_is_replaced_and_not_followed(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to(target)
    check_replaceable(link)
    assert not target.exists()
    with replacing(link) as stream:
        stream.write("precious")
    assert link.is_symlink(), "another link still points to its target"
    with replacing(link, follow=False, sync=True) as stream:
        stream.write("here")
    assert not link.is_symlink()
    assert link.read_text() == "here"
    assert target.read_text() == "precious"


@pytest.mark.parametrize("write", [check_replaceable, lambda path: replacing_bytes(path).__enter__()])
def test_a_link_with_the_name_of_the_temporary_file_is_not_followed(tmp_path, write):
    target = tmp_path / "target"
    target.write_text("precious")
    (tmp_path / f".a.{os.getpid()}.part").symlink_to(target)
    write(tmp_path / "a")
    assert target.read_text() == "precious"


def test_a_lock_or_table_that_is_a_link_or_no_regular_file_is_refused(tmp_path):
    target = tmp_path / "target"
    target.write_text("precious")
    (tmp_path / "link").symlink_to(target)
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("link", "is a link; expected a regular file"), ("pipe", "is a pipe; expected a regular file")):
        with pytest.raises(FileError, match=words), locked(tmp_path / name, SettingsError("held")):
            pass
        with pytest.raises(FileError, match=words):
            open_in_place(tmp_path / name, os.O_APPEND)
    assert target.read_text() == "precious"


def test_a_lock_keeps_others_out_until_it_is_given_back(tmp_path):
    def lock():
        return locked(tmp_path / "lock", SettingsError("held"))

    with lock(), pytest.raises(SettingsError, match="held"), lock():
        pass
    with lock():
        pass


def test_a_file_that_cannot_be_written_is_refused_by_check_and_write(tmp_path):
    check_replaceable(tmp_path / "deep" / "a.txt")
    assert list((tmp_path / "deep").iterdir()) == [], "the folder is created"
    with replacing(Path(os.devnull)) as stream:
        stream.write("gone")
    with pytest.raises(FileError, match="cannot be written"):
        check_replaceable(tmp_path)
    with pytest.raises(FileError, match="No space left"), replacing(Path("/dev/full")) as stream:
        stream.write("x")


@pytest.mark.parametrize(
    ("text", "size"),
    [("0", 0), ("1000", 1000), ("500MB", 500_000_000), ("8GiB", 2**33), ("1.5 kib", 1536), ("2T", 2 * 10**12), (7, 7)],
)
def test_sizes_are_read_with_decimal_and_binary_units(text, size):
    assert parse_bytes(text) == size


@pytest.mark.parametrize("text", ["", "much", "-1", "1e9", "5 XB", "nan", "1" * 30])
def test_other_sizes_are_refused(text):
    with pytest.raises(SettingsError, match="is not a size such as 500MB or 8GiB"):
        parse_bytes(text)


def test_only_regular_files_within_the_limit_are_read(tmp_path):
    file = tmp_path / "a.toml"
    file.write_text("x" * 10)
    check_readable(file, 10)
    assert read_text(file, 10) == "x" * 10
    with pytest.raises(FileError, match="10 bytes; the limit is 9"):
        read_text(file, 9)
    with pytest.raises(FileError, match="more than 5 bytes"):  # its size is given as 0
        read_text(Path("/proc/self/status"), 5)
    os.truncate(file, 2**33)
    with pytest.raises(FileError, match="8589934592 bytes; the limit is 4194304"):
        read_document(file)
    file.unlink()
    os.mkfifo(file)
    for path, kind in ((file, "a pipe"), (Path("/dev/zero"), "a character device"), (tmp_path, "a directory")):
        with pytest.raises(FileError, match=f"is {kind}; expected a regular file"):
            read_document(path)
    with pytest.raises(FileError, match="No such file"):
        read_document(tmp_path / "none.toml")


def test_what_is_not_to_be_followed_or_becomes_a_pipe_after_the_check_is_not_read(tmp_path, monkeypatch):
    (tmp_path / "secret").write_bytes(b"secret")
    (tmp_path / "link").symlink_to("secret")
    assert read_bytes(tmp_path / "link") == b"secret"
    with pytest.raises(FileError, match="is a link; expected a regular file"):
        read_bytes(tmp_path / "link", follow=False)
    os.mkfifo(tmp_path / "a")
    monkeypatch.setattr("hapticnet.files.check_readable", lambda *_: None)
    with pytest.raises(FileError, match="is a pipe; expected a regular file"):
        open_regular(tmp_path / "a")


def test_a_fresh_path_is_the_first_that_does_not_exist(tmp_path):
    assert fresh_path(tmp_path / "demo") == tmp_path / "demo"
    for name in ("demo", "demo-2"):
        (tmp_path / name).mkdir()
    assert fresh_path(tmp_path / "demo") == tmp_path / "demo-3"
