"""A growing file, renamed when it is complete."""

import fcntl
import glob
import os
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

from hapticnet.errors import FileError
from hapticnet.files import open_regular

UNFINISHED: Final = ".unfinished"  # suffix of a file that is being written, or was when its writer was killed
_MARK: Final = re.compile(re.escape(UNFINISHED) + r"(-\d+)?\Z")


class Sink:
    """Write to ``FILE.unfinished`` (or a free number of it), and rename it to FILE at the end; or raise OSError.

    Only whole calls of `flush` reach the file: if the disk is full, the file is cut back to the last one.
    """

    def __init__(self, path: Path, *, suffix: str | None = None) -> None:
        self.path = path
        self.file = path.with_name(path.name + (free_suffix(path) if suffix is None else suffix))
        self.size = 0
        self._waiting = bytearray()
        self._descriptor = os.open(self.file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # for `refuse_if_recorded`

    def write(self, data: bytes) -> int:
        """Append bytes; they reach the file with the next `flush`."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written so far."""
        return self.size + len(self._waiting)

    def flush(self) -> None:
        """Pass everything to the operating system."""
        if not self._waiting:
            return
        if not os.fstat(self._descriptor).st_nlink:
            raise FileNotFoundError(2, "the file was deleted", str(self.file))
        at = 0
        try:
            while at < len(self._waiting):
                at += os.write(self._descriptor, memoryview(self._waiting)[at:])
        except OSError:
            os.ftruncate(self._descriptor, self.size)
            os.lseek(self._descriptor, self.size, os.SEEK_SET)
            raise
        self.size += at
        self._waiting.clear()

    def close(self) -> None:
        """Close the file and keep its present name. Unflushed bytes are lost."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def discard(self) -> None:
        """Close and delete the file."""
        self.close()
        self.file.unlink(missing_ok=True)

    def finish(self) -> None:
        """Flush, close and rename. An existing FILE is replaced."""
        self.flush()
        self.close()
        self.file.replace(self.path)


def free_suffix(*paths: Path) -> str:
    """Return ``.unfinished``, or ``.unfinished-2`` and so on, the first with which none of the given files exists."""
    number, suffix = 1, UNFINISHED
    while any(os.path.lexists(path.with_name(path.name + suffix)) for path in paths):
        number += 1
        suffix = f"{UNFINISHED}-{number}"
    return suffix


def named(path: Path) -> Path:
    """Return the name that an unfinished file gets when it is complete; its own if it is."""
    return path.with_name(_MARK.sub("", path.name))


def beside(path: Path, what: str) -> Path:
    """Return the name of a file that belongs to FILE.csv, unfinished as that is."""
    whole = named(path)
    return path.with_name(f"{whole.stem}.{what}{path.name.removeprefix(whole.name)}")


def refuse_if_recorded(path: Path) -> None:
    """Raise FileError if a session still writes the recording that is to get this name."""
    for unfinished in sorted(path.parent.glob(f"{glob.escape(path.name)}{UNFINISHED}*")):
        if not unfinished.is_file() or unfinished.is_symlink():  # a writer has no others
            continue
        with open_regular(unfinished, sys.maxsize, follow=False) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise FileError(f"{unfinished} is still being written") from error
