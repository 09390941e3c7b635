"""Bounded reading of regular files only, and writing that neither follows links nor leaves half a file.

A folder may come from somebody else: a link in it could lead to any file of the user, so links are not followed.
"""

import errno
import fcntl
import io
import os
import re
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final, TextIO

from hapticnet.errors import FileError, HapticnetError, SettingsError

MAX_BYTES: Final = 2 * 2**30  # default size limit of files that are read [B]: 2 GiB
PART: Final = ".part"  # end of the name of a temporary file
_SIZE: Final = re.compile(r"(\d{1,15}(?:\.\d{1,6})?)\s*([KMGT]?)(i?)B?", re.ASCII | re.IGNORECASE)
_EXPECTED: Final = "expected a regular file"
_NOT_REGULAR: Final = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


def parse_bytes(text: str | int) -> int:
    """Return a size such as 500MB or 8GiB in bytes. Raises SettingsError if it is not such a size."""
    match = _SIZE.fullmatch(str(text).strip())
    if match is None:
        raise SettingsError(f'"{str(text)[:60]}" is not a size such as 500MB or 8GiB')
    number, prefix, binary = match.groups()
    return int(float(number) * (1024 if binary else 1000) ** " KMGT".index(prefix.upper() or " "))


def user_path(path: str | os.PathLike[str]) -> Path:
    """Return a user's path with a ``~`` at its start replaced: shells do not expand it in ``--key=~/key.toml``."""
    try:
        return Path(path).expanduser()
    except RuntimeError:  # no such user: the name of a file
        return Path(path)


def check_readable(path: Path, max_bytes: int = MAX_BYTES) -> None:
    """Check, without opening it, that `path` is a regular file of at most `max_bytes`; raise FileError if not."""
    try:
        status = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise FileError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    _refuse_special(path, status, max_bytes)


def open_regular(path: Path, max_bytes: int = MAX_BYTES, *, follow: bool = True) -> BinaryIO:
    """Open a regular file of at most `max_bytes`, and not a link unless `follow`; raises as `check_readable`."""
    if not follow and path.is_symlink():
        raise FileError(f"{path} is a link; {_EXPECTED}")
    check_readable(path, max_bytes)  # before it is opened: opening a device can have effects
    try:
        flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
        file = os.fdopen(os.open(path, flags), "rb")
    except OSError as error:
        raise FileError(f"{path}: {error.strerror or error}") from error
    try:
        _refuse_special(path, os.fstat(file.fileno()), max_bytes)  # it may have been replaced since
    except FileError:
        file.close()
        raise
    return file


def read_bytes(path: Path, max_bytes: int = MAX_BYTES, *, follow: bool = True) -> bytes:
    """Return the content of a regular file of at most `max_bytes`; see `open_regular`."""
    with open_regular(path, max_bytes, follow=follow) as file:
        try:
            content = file.read(max_bytes + 1)  # a file under /proc has size 0 and any content
        except OSError as error:
            raise FileError(f"{path}: {error.strerror or error}") from error
    if len(content) > max_bytes:
        raise FileError(f"{path}: more than {max_bytes} bytes, which is the limit")
    return content


def read_text(path: Path, max_bytes: int = MAX_BYTES, *, follow: bool = True) -> str:
    """Return the text of a UTF-8 file of at most `max_bytes`; raise FileError like `open_regular`, or if not UTF-8."""
    content = read_bytes(path, max_bytes, follow=follow)
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text: byte {error.start} is 0x{content[error.start]:02x}") from error


def _refuse_special(path: Path, status: os.stat_result, max_bytes: int) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for is_kind, name in _NOT_REGULAR if is_kind(status.st_mode)), "a special file")
        raise FileError(f"{path} is {kind}; {_EXPECTED}")
    if status.st_size > max_bytes:
        raise FileError(f"{path}: {status.st_size} bytes; the limit is {max_bytes}")


@contextmanager
def file_errors(path: Path) -> Iterator[None]:
    """Convert any exception of a reader of a damaged file to a FileError."""
    try:
        yield
    except HapticnetError:
        raise
    except MemoryError as error:
        raise FileError(f"{path}: too large for the memory of this machine") from error
    except Exception as error:  # SciPy and NumPy raise many kinds for damaged files
        known = isinstance(error, OSError) and error.strerror
        reason = known or f"damaged, or not the kind of file it seems: {' '.join(str(error).split())[:200]}"
        raise FileError(f"{path}: {reason}") from error


@contextmanager
def replacing(path: Path, *, follow: bool = True, sync: bool = False) -> Iterator[TextIO]:
    """Open a UTF-8 file for writing; it replaces an existing file once completely written. See `replacing_bytes`."""
    with replacing_bytes(path, follow=follow, sync=sync) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        try:
            yield text
            text.flush()
        finally:
            text.detach()


@contextmanager
def replacing_bytes(path: Path, *, follow: bool = True, sync: bool = False) -> Iterator[BinaryIO]:
    """Open a file for writing; it replaces an existing file once completely written. FileError if that fails.

    Devices, pipes and mount points (a file mounted into a container) are written directly. `follow` replaces what a
    link leads to: True only for a file that the user named. `sync` waits for the disk.
    """
    try:
        if follow and takes_a_stream(path):
            with path.open("wb") as file:
                yield file
            return
        with written_beside(Path(os.path.realpath(path)) if follow else path, sync=sync) as file:
            yield file
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


@contextmanager
def written_beside(path: Path, *, sync: bool = False) -> Iterator[BinaryIO]:
    """Open a temporary file; once written, it replaces `path`, even a link. Raises OSError."""
    part = _part(path)
    try:
        with _create(part) as file:
            yield file
            file.flush()
            if sync:
                os.fsync(file.fileno())
        if path.exists() and not path.is_symlink():
            shutil.copymode(path, part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def open_in_place(path: Path, flags: int = 0) -> int:
    """Return the descriptor of a file to change, made if missing; raise FileError if it is a link or special."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC | flags, 0o644)
    except OSError as error:
        reason = f" is a link; {_EXPECTED}" if error.errno == errno.ELOOP else f": cannot be written: {error.strerror}"
        raise FileError(f"{path}{reason}") from error
    try:
        _refuse_special(path, os.fstat(descriptor), sys.maxsize)
    except FileError:
        os.close(descriptor)
        raise
    return descriptor


@contextmanager
def locked(path: Path, busy: HapticnetError) -> Iterator[None]:
    """Hold the lock of a file, made if missing, until this process ends; raise `busy` if another process holds it."""
    descriptor = open_in_place(path)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise busy from error
        yield
    finally:
        os.close(descriptor)


def check_replaceable(path: Path) -> None:
    """Raise FileError if `replacing` cannot write a file, which does not change. Create its folder if it is missing."""
    make_folder(path.parent)
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        if not takes_a_stream(path):
            part = _part(Path(os.path.realpath(path)))
            _create(part).close()
            part.unlink()
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def takes_a_stream(path: Path) -> bool:
    """Return whether `path` is written directly: a pipe, a device, standard output or a mount point."""
    if path.parts[:2] == ("/", "dev") or os.path.ismount(path):
        return True
    return path.exists() and not path.is_file()


def check_folder(path: Path) -> None:
    """Raise FileError if files cannot be created in a folder. Create the folder if it is missing."""
    check_replaceable(path / "any")


def fresh_path(path: Path) -> Path:
    """Return the path itself if nothing exists there, else the first free one of name-2.suffix, name-3.suffix, …."""
    free, number = path, 2
    while free.exists():
        free, number = path.with_name(f"{path.stem}-{number}{path.suffix}"), number + 1
    return free


def make_folder(path: Path) -> None:
    """Create a folder and its parents if they are missing. Raises FileError if the folder cannot be created."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{path}: cannot create the folder: {error.strerror}") from error


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}{PART}")


def _create(part: Path) -> BinaryIO:
    """Create a temporary file and open it for writing. Remove an existing file of that name; never follow a link."""
    part.unlink(missing_ok=True)
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.fdopen(os.open(part, flags, 0o666), "w+b")
