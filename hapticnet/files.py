"""Files that are there whole or not at all."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from hapticnet.errors import FileError


@contextmanager
def replacing(path: Path) -> Iterator[TextIO]:
    """Open a file to be written as UTF-8; it takes the place of what was there once all of it is written.

    A disk that fills up half way, or an end in between, leaves what was there. A device or a pipe is written to, and
    so is a file that is a mount of its own, as in a container, which nothing can take the place of.

    Raises
    ------
    FileError
        When it cannot be written.
    """
    try:
        if takes_a_stream(path):
            with path.open("w", encoding="utf-8", newline="") as file:
                yield file
            return
        target, part = _places(path)
        try:
            with part.open("w", encoding="utf-8", newline="") as file:
                yield file
            if target.exists():
                shutil.copymode(target, part)
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def check_replaceable(path: Path) -> None:
    """Find out whether `replacing` could be done to a file, leaving it as it is; makes its folder where it is missing.

    Raises
    ------
    FileError
        When it could not.
    """
    make_folder(path.parent)
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        if not takes_a_stream(path):
            _, part = _places(path)
            with part.open("w"):
                pass
            part.unlink()
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def takes_a_stream(path: Path) -> bool:
    """Tell whether what is written to a path goes on from there: a pipe, a device, standard output, a mount."""
    if path.parts[:2] == ("/", "dev") or os.path.ismount(path):
        return True
    return path.exists() and not path.is_file()


def check_folder(path: Path) -> None:
    """Find out whether files could be made in a folder; makes it where it is missing.

    Raises
    ------
    FileError
        When they could not.
    """
    check_replaceable(path / "any")


def make_folder(path: Path) -> None:
    """Make a folder and all above it where they are missing; a FileError says why it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{path}: the folder cannot be made: {error.strerror}") from error


def _places(path: Path) -> tuple[Path, Path]:
    """Return the file itself, where `path` is a link to it, and where it is written until it is whole."""
    target = Path(os.path.realpath(path))
    return target, target.with_name(f".{target.name}.{os.getpid()}.part")
