"""Results are written completely or not at all, and only bounded regular files are read."""

import os
from pathlib import Path

import pytest

from hapticnet.documents import read_document
from hapticnet.errors import FileError, SettingsError
from hapticnet.files import (
    bytes_in_words,
    check_readable,
    check_replaceable,
    fresh_path,
    parse_bytes,
    read_text,
    replacing,
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


def test_a_link_still_points_to_its_target(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to(target)
    check_replaceable(link)
    assert not target.exists()
    with replacing(link) as stream:
        stream.write("here")
    assert link.is_symlink()
    assert target.read_text() == "here"


def test_a_check_creates_the_folder_only(tmp_path):
    check_replaceable(tmp_path / "deep" / "a.txt")
    assert list((tmp_path / "deep").iterdir()) == []


def test_a_device_is_written_directly():
    with replacing(Path(os.devnull)) as stream:
        stream.write("gone")


def test_a_file_that_cannot_be_written_is_refused_by_check_and_write(tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        check_replaceable(tmp_path)
    with pytest.raises(FileError, match="No space left"), replacing(Path("/dev/full")) as stream:
        stream.write("x")


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("0", 0),
        ("1000", 1000),
        ("500MB", 500_000_000),
        ("8GiB", 8 * 2**30),
        ("1.5 kib", 1536),
        ("2T", 2 * 10**12),
        (7, 7),
    ],
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
    file.unlink()
    os.mkfifo(file)
    for path, kind in ((file, "a pipe"), (Path("/dev/zero"), "a character device"), (tmp_path, "a directory")):
        with pytest.raises(FileError, match=f"is {kind}; expected a regular file"):
            read_document(path)
    with pytest.raises(FileError, match="No such file"):
        read_document(tmp_path / "none.toml")


def test_a_document_that_is_too_large_is_refused_without_reading_it(tmp_path):
    with (tmp_path / "a.toml").open("wb") as file:
        file.truncate(2**33)
    with pytest.raises(FileError, match="8589934592 bytes; the limit is 4194304"):
        read_document(tmp_path / "a.toml")


def test_a_fresh_path_is_the_first_that_does_not_exist(tmp_path):
    assert fresh_path(tmp_path / "demo") == tmp_path / "demo"
    for name in ("demo", "demo-2"):
        (tmp_path / name).mkdir()
    assert fresh_path(tmp_path / "demo") == tmp_path / "demo-3"


@pytest.mark.parametrize("text", ["2GiB", "500MB", "3MiB", "7GB", "1234567"])
def test_a_size_in_words_can_be_read_again(text):
    assert bytes_in_words(parse_bytes(text)) == text
