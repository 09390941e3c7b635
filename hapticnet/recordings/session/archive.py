"""The recordings that a writer process has in hand: what to do with each frame, within a limit of disk space."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol

import msgpack
import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import HapticnetError, SettingsError, in_words
from hapticnet.recordings.session.csv_writer import CsvWriter
from hapticnet.recordings.session.frames import Frame, FrameKind, Heading, unpack_heading
from hapticnet.recordings.session.mcap_writer import McapWriter
from hapticnet.recordings.session.npz_writer import NpzWriter
from hapticnet.recordings.session.sink import Sink


class RecordingWriter(Protocol):
    """Write one recording of one format. Every method raises OSError if the disk fails."""

    @property
    def files(self) -> tuple[Sink, ...]:
        """The files being written."""

    @property
    def size(self) -> int:
        """At most how much disk space the recording takes if it is finished now [B]."""

    def bound(self, table: int, rows: int) -> int:
        """Return at most how many bytes this many more rows take."""

    def rows(self, table: int, rows: FloatArray) -> None:
        """Add rows, shape (n, columns)."""

    def event(self, t_us: int, name: str, text: str) -> None:
        """Add an event."""

    def flush(self) -> None:
        """Pass everything to the operating system, such that it can be recovered."""

    def finish(self, about: Mapping[str, Any]) -> None:
        """Complete the files."""


FORMATS: Final[dict[str, Callable[[Heading], RecordingWriter]]] = {
    ".mcap": McapWriter,
    ".csv": CsvWriter,
    ".npz": NpzWriter,
}
"""Formats by the suffix of the file."""

MOST_FILES: Final = {".mcap": (1, 1), ".csv": (5, 4), ".npz": (6, 1)}
"""Most files and folders of a recording by the suffix: while it is written or unfinished, and when it is complete."""


def check_format(path: Path) -> None:
    """Raise SettingsError if a recording cannot have this name, UnavailableError if its format needs an extra."""
    if path.suffix.lower() not in FORMATS:
        raise SettingsError(f"{path}: a recording is a .mcap, .csv or .npz file")
    if path.suffix.lower() == ".mcap":
        check_mcap()


class Archive:
    """Carry out frames.

    The first fault, or the limit, completes everything as it is, as far as the disk permits.

    Parameters
    ----------
    stop
        Called once when nothing more is recorded: with the reason, and whether it is a fault rather than the limit.
    tell
        Called with what else the user should know.

    Attributes
    ----------
    completed
        Number of recordings that are complete.
    """

    def __init__(self, stop: Callable[[str, bool], None], tell: Callable[[str], None], *, limit_bytes: int) -> None:
        self.stopped = False
        self.completed = 0
        self._stop = stop
        self._tell = tell
        self._limit_bytes = limit_bytes
        self._saved_bytes = 0
        self._open: dict[int, tuple[RecordingWriter, Heading, dict[str, Any]]] = {}

    def take(self, frame: Frame) -> None:
        """Carry out a frame."""
        if self.stopped:
            return
        try:
            self._take(frame)
        except (OSError, HapticnetError) as error:
            self._fail(frame.recording, error)

    def flush(self) -> None:
        """Pass everything to the operating system."""
        for number in list(self._open):
            if number in self._open:  # a fault ends all
                try:
                    self._open[number][0].flush()
                except OSError as error:
                    self._fail(number, error)

    def finish(self) -> None:
        """Complete all recordings."""
        for number in list(self._open):
            self._finish(number)

    def _take(self, frame: Frame) -> None:
        number = frame.recording
        if frame.kind is FrameKind.BEGIN:
            heading = unpack_heading(frame.content)
            self._open[number] = FORMATS[heading.path.suffix.lower()](heading), heading, {}
            return
        if number not in self._open:
            return
        writer, heading, about = self._open[number]
        if frame.kind is FrameKind.ROWS:
            table = frame.content[0]
            rows = np.frombuffer(frame.content[1:]).reshape(-1, len(heading.tables[table].columns))
            if shift_us := heading.tables[table].shift_us:
                rows = np.concatenate([rows[:, :1] + shift_us, rows[:, 1:]], axis=1)
            if self._size() + writer.bound(table, len(rows)) > self._limit_bytes:
                self._end(f"the limit of {self._limit_bytes:,} bytes for recordings is reached", is_fault=False)
                return
            writer.rows(table, rows)
        elif frame.kind is FrameKind.EVENT:
            writer.event(*msgpack.unpackb(frame.content))
        elif frame.kind is FrameKind.ABOUT:
            about |= msgpack.unpackb(frame.content)
        else:
            self._finish(number)

    def _size(self) -> int:
        return self._saved_bytes + sum(writer.size for writer, _, _ in self._open.values())

    def _finish(self, number: int) -> None:
        if number not in self._open:
            return
        writer, _, about = self._open[number]
        try:
            writer.finish(about)
        except (OSError, HapticnetError) as error:
            self._fail(number, error)
        else:
            del self._open[number]
            self._saved_bytes += writer.size
            self.completed += 1

    def _fail(self, number: int, error: Exception) -> None:
        """Leave a recording as it is, and end the others."""
        reason = in_words(error)
        if isinstance(error, OSError):
            reason = f"{error.filename or ''}: {error.strerror}".removeprefix(": ")
        if number in self._open:
            writer, heading, _ = self._open.pop(number)
            kept = [sink for sink in writer.files if sink.size]
            for sink in writer.files:
                sink.close()
            reason = f"{heading.path}: {getattr(error, 'strerror', None) or reason}"
            if kept:
                reason += f"; what was written can be completed with 'hapticnet recover {_unfinished(writer)}'"
        if self.stopped:
            self._tell(reason)
        else:
            self._end(reason, is_fault=True)

    def _end(self, reason: str, *, is_fault: bool) -> None:
        self.stopped = True
        self._stop(reason, is_fault)
        self.finish()


def _unfinished(writer: RecordingWriter) -> Path:
    return writer.folder if isinstance(writer, NpzWriter) else writer.files[0].file


def check_mcap() -> None:
    """Raise UnavailableError if the extra ``record`` is not installed."""
    from importlib.util import find_spec

    from hapticnet.errors import UnavailableError
    from hapticnet.recordings.session.mcap_writer import NEEDS_MCAP

    if find_spec("mcap") is None:
        raise UnavailableError(NEEDS_MCAP)
