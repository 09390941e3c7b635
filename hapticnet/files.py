"""Bounded reading, and writing that replaces a file only when all of it is written."""

import errno
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TextIO

from hapticnet.errors import FileError, HapticnetError, SettingsError

MAX_BYTES: Final = 2 * 2**30
"""Default size limit of files that are read [B]: 2 GiB."""

_SIZE: Final = re.compile(r"(\d{1,15}(?:\.\d{1,6})?)\s*([KMGT]?)(i?)B?", re.ASCII | re.IGNORECASE)
_NOT_REGULAR: Final = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


def parse_bytes(text: str | int) -> int:
    """Return a size such as 500MB or 8GiB in bytes.

    Raises
    ------
    SettingsError
        If it is not such a size.
    """
    match = _SIZE.fullmatch(str(text).strip())
    if match is None:
        raise SettingsError(f'"{str(text)[:60]}" is not a size such as 500MB or 8GiB')
    number, prefix, binary = match.groups()
    return int(float(number) * (1024 if binary else 1000) ** " KMGT".index(prefix.upper() or " "))


def bytes_in_words(size: int) -> str:
    """Return a size [B] as `parse_bytes` reads it, with the largest unit that leaves a whole number."""
    for unit, name in ((2**30, "GiB"), (10**9, "GB"), (2**20, "MiB"), (10**6, "MB")):
        if size > 0 and size % unit == 0:
            return f"{size // unit}{name}"
    return str(size)


def user_path(path: str | os.PathLike[str]) -> Path:
    """Return a path as a user wrote it, with a ``~`` at its start replaced by a home folder, as a shell does.

    A shell does so only at the start of a word, and Python nowhere: ``--key=~/key.toml`` arrives as it is written.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError:  # no such user: the name of a file
        return Path(path)


def check_readable(path: Path, max_bytes: int = MAX_BYTES) -> None:
    """Check, without opening it, that `path` is a regular file of at most `max_bytes`.

    Raises
    ------
    FileError
        If the file is missing, is a directory, device, pipe or socket, or is too large.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise FileError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for is_kind, name in _NOT_REGULAR if is_kind(status.st_mode)), "a special file")
        raise FileError(f"{path} is {kind}; expected a regular file")
    if status.st_size > max_bytes:
        raise FileError(f"{path}: {status.st_size} bytes; the limit is {max_bytes}")


def read_text(path: Path, max_bytes: int = MAX_BYTES) -> str:
    """Return the text of a UTF-8 file of at most `max_bytes`.

    Raises
    ------
    FileError
        If the file cannot be read, is too large or is not UTF-8.
    """
    check_readable(path, max_bytes)
    try:
        with path.open("rb") as file:
            content = file.read(max_bytes + 1)  # a file under /proc has size 0 and any content
    except OSError as error:
        raise FileError(f"{path}: {error.strerror or error}") from error
    if len(content) > max_bytes:
        raise FileError(f"{path}: more than {max_bytes} bytes, which is the limit")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text: byte {error.start} is 0x{content[error.start]:02x}") from error


@contextmanager
def file_errors(path: Path) -> Iterator[None]:
    """Turn any exception that a reader raises on a damaged file into a FileError."""
    try:
        yield
    except HapticnetError:
        raise
    except MemoryError as error:
        raise FileError(f"{path}: too large for the memory of this machine") from error
    except Exception as error:  # SciPy, pyarrow and NumPy raise many kinds for damaged files
        known = isinstance(error, OSError) and error.strerror
        reason = known or f"damaged, or not the kind of file it seems: {' '.join(str(error).split())[:200]}"
        raise FileError(f"{path}: {reason}") from error


@contextmanager
def replacing(path: Path) -> Iterator[TextIO]:
    """Open a UTF-8 file for writing; it replaces an existing file when all of it is written.

    If writing fails or is interrupted, the existing file is unchanged. Devices, pipes and mount points (a file mounted
    into a container) cannot be replaced, so they are written directly.

    Raises
    ------
    FileError
        If the file cannot be written.
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
    """Check that `replacing` can write a file, without changing the file. Create its folder if it is missing.

    Raises
    ------
    FileError
        If it cannot be written.
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
    """Return whether `path` is written directly: a pipe, a device, standard output or a mount point."""
    if path.parts[:2] == ("/", "dev") or os.path.ismount(path):
        return True
    return path.exists() and not path.is_file()


def check_folder(path: Path) -> None:
    """Check that files can be created in a folder. Create the folder if it is missing.

    Raises
    ------
    FileError
        If they cannot.
    """
    check_replaceable(path / "any")


def fresh_path(path: Path) -> Path:
    """Return the path itself if nothing exists there, else the first free one of path-2, path-3, …."""
    number = 2
    free = path
    while free.exists():
        free = path.with_name(f"{path.name}-{number}")
        number += 1
    return free


def make_folder(path: Path) -> None:
    """Create a folder and its parents if they are missing.

    Raises
    ------
    FileError
        If the folder cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{path}: cannot create the folder: {error.strerror}") from error


def _places(path: Path) -> tuple[Path, Path]:
    """Return the file that `path` refers to, following links, and the temporary file beside it."""
    target = Path(os.path.realpath(path))
    return target, target.with_name(f".{target.name}.{os.getpid()}.part")
