"""Complete recordings after their writer was killed or the disk was full."""

import fcntl
import glob
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hapticnet.errors import FileError, HapticnetError
from hapticnet.files import MAX_BYTES, check_readable, check_replaceable, open_in_place, open_regular
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.mcap_reader import read_mcap
from hapticnet.recordings.session.sink import UNFINISHED, beside, named

_BLOCK: Final = 1 << 16
MOST_PER_BYTE: Final = 100  # times the size of its file that a recovered one may unpack to, or `MAX_BYTES`


@dataclass(frozen=True, slots=True)
class Recovered:
    """A recovered recording."""

    path: Path  # the complete file
    count: int  # rows of the main table
    was_complete: bool  # the file was complete already; nothing was written then


def recover_file(path: Path, out: Path | None = None) -> Recovered:
    """Make a complete recording of ``FILE.unfinished``, which is deleted, or of a damaged .mcap file, which is kept.

    `out` is the target; None: FILE, or for an .mcap file ``NAME-recovered.mcap``. Raise FileError if it cannot be
    read, a session still writes it, or the complete one cannot be written or exists already.
    """
    unfinished = path.parent / (path.name + UNFINISHED)
    if not path.exists() and unfinished.exists():
        path = unfinished
    if not path.exists():
        raise FileError(f"{path}: no such file")
    check_readable(path, max_bytes=sys.maxsize)
    try:
        if UNFINISHED not in path.name:  # this one is only read; others are changed and deleted
            if path.suffix.lower() != ".mcap":
                raise FileError(f"{path}: only .mcap files and *{UNFINISHED} can be recovered")
            return _mend(path, out or path.with_name(f"{path.stem}-recovered{path.suffix}"))
        if path.is_symlink():
            raise FileError(f"{path} is a link; name the file that it leads to")
        _refuse_if_written(path)
        target = out or named(path)
        kind = named(path).suffix.lower()
        if kind == ".csv":
            _refuse_existing(target)
            return Recovered(target, _complete_csv(path, target), was_complete=False)
        if kind != ".mcap":
            raise FileError(f"{path}: not an unfinished recording; expected .mcap or .csv before {UNFINISHED}")
        done = _mend(path, target, rename=True)
        path.unlink()
        return done
    except HapticnetError:
        raise
    except Exception as error:  # a damaged file raises many kinds
        reason = (isinstance(error, OSError) and error.strerror) or f"damaged ({error})"
        raise FileError(f"{path}: cannot be recovered: {reason}") from error


def _mend(path: Path, target: Path, *, rename: bool = False) -> Recovered:
    """Write the undamaged part of an .mcap file to another, unless it is complete and has its final name."""
    if target.suffix.lower() != ".mcap":
        raise FileError(f"{target}: expected a name that ends in .mcap")
    session = read_mcap(path, max(MAX_BYTES, MOST_PER_BYTE * path.stat().st_size))
    was_complete = session.is_whole and not rename
    if not was_complete:
        _refuse_existing(target)
        export(session, target)
    return Recovered(path if was_complete else target, len(session.main["t_us"]), was_complete)


def _refuse_existing(target: Path) -> None:
    if os.path.lexists(target):
        raise FileError(f"{target} exists; name another file with --out")
    check_replaceable(target)


def refuse_if_recorded(path: Path) -> None:
    """Raise FileError if a session still writes the recording with this final name."""
    for unfinished in sorted(path.parent.glob(f"{glob.escape(path.name)}{UNFINISHED}*")):
        _refuse_if_written(unfinished)


def _refuse_if_written(path: Path) -> None:
    if not path.is_file() or path.is_symlink():  # only writers have these names
        return
    with open_regular(path, sys.maxsize, follow=False) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileError(f"{path} is still being written") from error


def _complete_csv(path: Path, target: Path) -> int:
    """Cut off the row that was not written completely, and rename the file and those beside it."""
    original = named(path)
    suffix = path.name.removeprefix(original.name)
    moves = {
        file: beside(target, what)
        for what in ("datagrams.csv", "events.csv", "about.json")
        if os.path.lexists(file := beside(original, f"{what}{suffix}"))
    } | {path: target}
    for file in moves:  # before anything is changed
        open_regular(file, sys.maxsize, follow=False).close()
    rows = 0
    for file, place in moves.items():
        if named(file).suffix.lower() == ".csv":
            rows = _cut_to_lines(file) - 1
        place.unlink(missing_ok=True)
        shutil.move(file, place)  # perhaps to another disk
    return max(0, rows)


def _cut_to_lines(path: Path) -> int:
    """Truncate a file after its last complete line, and return the number of lines."""
    lines = end = at = 0
    with os.fdopen(open_in_place(path), "r+b") as file:
        while block := file.read(_BLOCK):
            lines += block.count(b"\n")
            last = block.rfind(b"\n")
            if last >= 0:
                end = at + last + 1
            at += len(block)
        file.truncate(end)
    return lines
