"""Recordings on disk: a thread appends rows to spool files, and makes CSV files of them when nobody waits.

The process keeps half a second of rows, and disk space is bounded. If the process is killed, its spool files remain:
a line with the names of the columns, then rows of float64.
"""

import csv
import os
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

from hapticnet.errors import FileError, in_words
from hapticnet.files import fresh_path, replacing
from hapticnet.node.recording import Recording
from hapticnet.runtime.background import start_background

SPOOL_SUFFIX: Final = ".unfinished"

MOST_FILES: Final = 1000
"""Most sessions recorded in a run."""

MOST_WAITING_BYTES: Final = 64 * 2**20
"""Most bytes that wait for the disk: 19 minutes of one session of 1 kHz, 18 s of 64."""

BYTES_PER_NUMBER: Final = 28
"""Disk space planned for a number: 8 bytes of spool, and at most 20 characters of CSV on average."""

ROWS_AT_ONCE: Final = 64
PAUSE_S: Final = 0.0005
"""While the process serves, that many rows become CSV in a row, in about 0.5 ms, followed by a pause: the thread holds
the interpreter's lock meanwhile, and a master may be asking for a session."""


@dataclass(slots=True)
class _Spool:
    """Rows on disk, and the CSV file at `path` that they become; `bytes` are those that were written completely."""

    path: Path
    columns: tuple[str, ...]
    file: Path
    planned_bytes: int = 0
    bytes: int = 0
    failed: bool = False


class Recorder:
    """Write recordings while they grow.

    `collect` often enough, then `end` each recording, and `finish` the run. Only `finish` waits for the disk. A disk
    that is full, slow or gone ends the recording, not the run.

    Parameters
    ----------
    tell
        Called with a line for the user when something is not recorded.
    limit_bytes
        Bound of the disk space taken.
    """

    def __init__(self, tell: Callable[[str], None], *, limit_bytes: int) -> None:
        self._tell = tell
        self._limit_bytes = limit_bytes
        self._files = 0
        self._not_recorded = 0
        self._stopped: str | None = None
        self._spools: dict[Path, _Spool] = {}
        self._unrecorded: set[Path] = set()
        # Each of these is changed by one thread only, and read by the other.
        self._planned_bytes = self._handed_bytes = 0
        self._saved_bytes = self._taken_bytes = 0
        self._faults: deque[str] = deque()
        self._first_fault: str | None = None
        self._nobody_waits = False
        self._finishing = False
        self._to_convert: deque[_Spool] = deque()
        self._queue: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._finished = threading.Event()
        start_background(self._work, "recorder")

    def collect(self, recording: Recording, path: Path) -> None:
        """Hand over the rows that were added since the last call; `path` is the CSV file they end up in."""
        numbers = recording.take()
        self._tell_faults()
        if not numbers or self._stopped is not None:
            return
        spool = self._spools.get(path) or self._open(recording.columns, path)
        if spool is None:
            return
        planned = BYTES_PER_NUMBER * len(numbers)
        size = numbers.itemsize * len(numbers)
        if self._planned_bytes - self._saved_bytes + planned > self._limit_bytes:
            self._stop(f"the limit of {self._limit_bytes:,} bytes is reached (--record-limit)")
        elif self._handed_bytes - self._taken_bytes + size > MOST_WAITING_BYTES:
            self._stop(f"the disk is too slow for {path.parent}")
            self._first_fault = self._stopped
        else:
            spool.planned_bytes += planned
            self._planned_bytes += planned
            self._handed_bytes += size
            self._queue.put(lambda: self._append(spool, numbers))

    def end(self, path: Path) -> None:
        """Complete a recording: nothing more will be added to it."""
        self._unrecorded.discard(path)
        spool = self._spools.pop(path, None)
        if spool is not None:
            self._queue.put(lambda: self._to_convert.append(spool))

    def set_idle(self, nobody_waits: bool) -> None:
        """Set whether CSV files may be made now."""
        if nobody_waits != self._nobody_waits:
            self._nobody_waits = nobody_waits
            self._queue.put(lambda: None)  # wakes the thread

    def finish(self) -> None:
        """Complete all recordings and wait until they are written.

        Raises
        ------
        FileError
            If one could not be written completely.
        """
        for path in list(self._spools):
            self.end(path)
        self._finishing = True
        self._queue.put(lambda: None)
        try:
            self._finished.wait()
        except KeyboardInterrupt:
            self._tell(f"interrupted; rows that are in no CSV file yet are kept in *{SPOOL_SUFFIX}")
            raise
        self._tell_faults()
        if self._not_recorded:
            self._tell(f"{self._not_recorded:,} sessions were not recorded")
        if self._first_fault is not None:
            raise FileError(f"the recordings are incomplete: {self._first_fault}")

    def report(self) -> dict[str, Any]:
        """Return the account of what was recorded for JSON."""
        return {"files": self._files, "sessions_not_recorded": self._not_recorded, "stopped": self._stopped}

    def _open(self, columns: tuple[str, ...], path: Path) -> _Spool | None:
        if self._files >= MOST_FILES:
            if path not in self._unrecorded:
                if not self._not_recorded:
                    self._tell(f"{MOST_FILES:,} sessions are recorded; later ones are not")
                self._not_recorded += 1
                self._unrecorded.add(path)
            return None
        self._files += 1
        spool = _Spool(path, columns, path.with_name(path.name + SPOOL_SUFFIX))
        self._spools[path] = spool
        self._queue.put(lambda: self._begin(spool))
        return spool

    def _stop(self, reason: str) -> None:
        self._stopped = reason
        self._tell(f"recording stops: {reason}")

    def _tell_faults(self) -> None:
        while self._faults:
            fault = self._faults.popleft()
            self._first_fault = self._first_fault or fault
            if self._stopped is None:
                self._stop(fault)
            else:
                self._tell(fault)

    # What follows runs in the thread.

    def _work(self) -> None:
        try:
            self._serve()
        except Exception as error:  # so that the run neither waits for this thread nor believes it
            self._faults.append(in_words(error))
        finally:
            self._finished.set()

    def _serve(self) -> None:
        conversion: Iterator[None] | None = None
        while True:
            may_convert = self._nobody_waits or self._finishing
            if conversion is None and self._to_convert and may_convert:
                conversion = self._convert(self._to_convert.popleft())
            busy = conversion is not None and may_convert
            try:
                task = self._queue.get(block=not busy and not self._finishing)
            except Empty:
                if conversion is None:
                    return
                if next(conversion, self) is self:
                    conversion = None
                if not self._finishing:
                    time.sleep(PAUSE_S)
            else:
                task()

    def _begin(self, spool: _Spool) -> None:
        try:
            spool.file = fresh_path(spool.file)
            with spool.file.open("xb") as file:
                spool.bytes = file.write(",".join(spool.columns).encode() + b"\n")
        except OSError as error:
            self._fail(spool, error)

    def _append(self, spool: _Spool, numbers: "array[float]") -> None:
        size = numbers.itemsize * len(numbers)
        try:
            if not spool.failed:
                # Opened each time: no descriptor is held for each session, and a folder that is gone is noticed.
                with spool.file.open("r+b") as file:
                    file.seek(spool.bytes)
                    file.write(numbers)
                spool.bytes += size
        except OSError as error:
            self._fail(spool, error)
        finally:
            self._taken_bytes += size

    def _fail(self, spool: _Spool, error: OSError) -> None:
        spool.failed = True
        self._faults.append(f"{spool.file}: {error.strerror}")
        with suppress(OSError):
            os.truncate(spool.file, spool.bytes)  # whole rows only

    def _convert(self, spool: _Spool) -> Iterator[None]:
        """Make a CSV file of a spool, some rows each time."""
        width = len(spool.columns)
        try:
            with spool.file.open("rb") as rows, replacing(spool.path) as file:
                rows.readline()
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(spool.columns)
                while data := rows.read(8 * width * ROWS_AT_ONCE):
                    numbers = array("d", data[: len(data) // (8 * width) * 8 * width])
                    writer.writerows(zip(*[iter(numbers)] * width, strict=True))
                    yield
            spool.file.unlink()
            self._saved_bytes += spool.planned_bytes - spool.path.stat().st_size
        except (FileError, OSError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            self._faults.append(f"{reason}; the rows are kept in {spool.file}")
