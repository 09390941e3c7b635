"""Files that are there whole or not at all."""

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

    A disk that fills up half way, or an end in between, leaves what was there. A device or a pipe is written to.

    Raises
    ------
    FileError
        When it cannot be written.
    """
    try:
        if path.exists() and not path.is_file():
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
        if path.exists():
            with path.open("a"):
                pass
        if path.is_file() or not path.exists():
            _, part = _places(path)
            with part.open("w"):
                pass
            part.unlink()
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def make_folder(path: Path) -> None:
    """Make a folder and all above it where they are missing; a FileError says why it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{path}: the folder cannot be made: {error.strerror}") from error


def _places(path: Path) -> tuple[Path, Path]:
    """Return the file itself, where `path` is a link to it, and where it is written until it is whole."""
    target = path.resolve()
    return target, target.with_name(f".{target.name}.{os.getpid()}.part")
