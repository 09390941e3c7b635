"""Recordings of running nodes: rows and events go to the writer process in batches, between ticks."""

import asyncio
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import msgpack

from hapticnet.errors import FileError, in_words
from hapticnet.recordings.session.archive import MOST_FILES
from hapticnet.recordings.session.frames import FrameKind, Heading, Table
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.feed import Feed

BATCH_S: Final = 0.05
"""Rows are handed to the writer this often. A node that is killed loses what is younger."""

CATCH_UP_S: Final = 0.005
"""The same while bytes wait."""

FILE_LIMIT: Final = 1000
"""Most files and folders that the recordings of a run may be."""

RECORD_LIMIT_BYTES: Final = 2 * 2**30
"""Disk space [B] that recordings may take unless another limit is given."""


class Recorder:
    """Hand recordings to a writer process.

    `open` each, give rows to `feed`, `end` each, and `finish` the run. Only `finish` waits. A disk that is full,
    slow or gone ends the recording, not the run.

    Parameters
    ----------
    tell
        Called with a line for the user when something is not recorded.
    limit_bytes
        Bound of the disk space taken.
    about
        Configuration, seed and versions, for every file.
    """

    def __init__(
        self, tell: Callable[[str], None], *, limit_bytes: int, about: Mapping[str, Any] | None = None
    ) -> None:
        self.feed = Feed(tell, limit_bytes=limit_bytes)
        self._tell = tell
        self._about = dict(about or {})
        self._files = 0
        self._open: dict[int, int] = {}  # what of these goes when a recording is complete
        self._not_recorded = 0

    def open(
        self, path: Path, side: str, tables: Sequence[Table], unix_offset_us: int, about: Mapping[str, Any]
    ) -> int | None:
        """Begin a recording and return its number; None if there are too many.

        Parameters
        ----------
        tables
            The main one first.
        unix_offset_us
            Add it to the rows' `t_us` for µs since 1970.
        """
        most, complete = MOST_FILES[path.suffix.lower()]
        if self._files + most > FILE_LIMIT:
            if not self._not_recorded:
                self._tell(f"the recordings have {FILE_LIMIT:,} files; a session that begins now is not recorded")
            self._not_recorded += 1
            return None
        self._files += most
        number = self.feed.begun + 1
        self._open[number] = most - complete
        heading = Heading(
            path=path.absolute(),
            side=side,
            tables=tuple(tables),
            unix_offset_us=unix_offset_us,
            about={**self._about, **about},
        )
        self.feed.begin(number, heading)
        return number

    def event(self, number: int, t_us: int, event: object) -> None:
        """Record an event of a node."""
        content = msgpack.packb([t_us, type(event).__name__, event_text(event)])
        self.feed.tell_writer(FrameKind.EVENT, number, content)

    def end(self, number: int, about: Mapping[str, Any]) -> None:
        """Complete a recording; `about` is what is known only now, such as the report."""
        self.feed.tell_writer(FrameKind.ABOUT, number, msgpack.packb(dict(about), default=str))
        self.feed.tell_writer(FrameKind.END, number)
        self._files -= self._open.pop(number)

    def finish(self) -> None:
        """Wait until the files are complete."""
        self.feed.finish()
        if self._not_recorded:
            self._tell(f"{self._not_recorded:,} sessions were not recorded")

    def check(self) -> None:
        """Raise FileError if a recording could not be written completely. Reaching the limit is no error."""
        if self.feed.fault is not None:
            raise FileError(f"the recordings are incomplete: {self.feed.fault}")

    def report(self) -> dict[str, Any]:
        """Return the account of what was recorded for JSON."""
        return {
            "begun": self.feed.begun,
            "completed": self.feed.completed,
            "sessions_not_recorded": self._not_recorded,
            "stopped": self.feed.stopped,
        }


class Batches:
    """Call a function on the loop every `BATCH_S`; sooner while the writer is behind or the function has more to do."""

    def __init__(self, recorder: Recorder, collect: Callable[[], bool]) -> None:
        self._recorder = recorder
        self._collect = collect
        self._handle: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Start; call it on the loop."""
        self._handle = asyncio.get_running_loop().call_later(BATCH_S, self._fire)

    async def stop(self) -> None:
        """Stop, and wait for the writer without holding up the loop."""
        if self._handle is not None:
            self._handle.cancel()
        await asyncio.to_thread(self._recorder.finish)

    def _fire(self) -> None:
        feed = self._recorder.feed
        try:
            more = not feed.is_behind and self._collect()
            feed.pump()
        except Exception as error:  # of the recorder's own code; the run must go on
            feed.stop(f"the recorder failed: {in_words(error)}", is_fault=True)
            return
        pause_s = CATCH_UP_S if more or feed.is_behind else BATCH_S
        self._handle = asyncio.get_running_loop().call_later(pause_s, self._fire)


def unix_offset_us() -> int:
    """Return what to add to this process's `now_us` for µs since 1970."""
    return time.time_ns() // 1000 - now_us()


def event_text(event: object) -> str:
    """Return the plain fields of an event as JSON. Tickets, keys and objects of the node are left out."""
    return json.dumps(_plain(event), default=str)


def _plain(value: object) -> dict[str, Any]:
    if is_dataclass(value) and not isinstance(value, type):
        items = {field.name: getattr(value, field.name) for field in fields(value)}
    else:
        items = getattr(value, "_asdict", dict)()
    kept: dict[str, Any] = {}
    for name, item in items.items():
        if item is None or isinstance(item, (str, int, float, dict)):  # a dict: the parameters of a codec
            kept[name] = item
        elif hasattr(item, "_asdict"):
            kept[name] = _plain(item)
    return kept
