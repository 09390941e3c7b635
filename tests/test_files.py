"""Results are there whole or not at all, and nothing that was there is lost for one that fails."""

import os
from pathlib import Path

import pytest

from hapticnet.errors import FileError
from hapticnet.files import check_replaceable, replacing


def test_a_file_takes_the_place_of_what_was_there_and_keeps_its_rights(tmp_path):
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
def test_what_fails_half_way_leaves_what_was_there(tmp_path, failure):
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


def test_a_link_goes_on_pointing_where_it_did(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to(target)
    check_replaceable(link)
    assert not target.exists()
    with replacing(link) as stream:
        stream.write("here")
    assert link.is_symlink()
    assert target.read_text() == "here"


def test_a_check_leaves_nothing_behind_but_the_folder(tmp_path):
    check_replaceable(tmp_path / "deep" / "a.txt")
    assert list((tmp_path / "deep").iterdir()) == []


def test_a_device_is_written_to_as_it_is():
    with replacing(Path(os.devnull)) as stream:
        stream.write("gone")


def test_what_cannot_be_written_is_refused_by_the_check_and_by_the_writing(tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        check_replaceable(tmp_path)
    with pytest.raises(FileError, match="No space left"), replacing(Path("/dev/full")) as stream:
        stream.write("x")
