"""Recordings of running nodes, a file for a master or each session: a writer process gets batches between ticks."""

import asyncio
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic

from hapticnet.errors import FileError, in_words
from hapticnet.node.events import MasterJoined, MasterLeft, MasterRefused, NodeEvent, SettingsInForce, SlaveEvent
from hapticnet.node.master import MasterNode
from hapticnet.node.recording import Recording
from hapticnet.node.settings import MasterSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.node.slave_context import SlaveContext
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.recordings.session.archive import FILES
from hapticnet.recordings.session.frames import FrameKind, Heading, pack_begin, pack_frame, pack_rows_header
from hapticnet.recordings.session.session import Table
from hapticnet.runtime.processes import SideProcess
from hapticnet.runtime.system import now_us
from hapticnet.runtime.watching import Event, Watcher
from hapticnet.runtime.writer import DONE, FAILED, STOPPED

if TYPE_CHECKING:
    from array import array

FILE_LIMIT: Final = 1000  # most files and folders of a run's recordings
MOST_WAITING_BYTES: Final = 64 * 2**20  # most bytes for the writer: 10 minutes of one session of 1 kHz, 10 s of 64
FINISH_WITHIN_S: Final = 60.0  # longest time that the end of a run waits for the writer
BATCH_S: Final = 0.05  # time between two batches for the writer: a killed node loses younger rows
CATCH_UP_S: Final = 0.005  # the same while bytes wait, or sessions are due
MOST_EARLY_EVENTS: Final = 1000  # most events that are kept until there is a first row
MOST_AT_ONCE: Final = 16  # most sessions of a slave that are collected in one call, in about 0.1 ms
WIRE_VERSIONS: Final = {"open": OPEN, "sealed": SEALED}


class Recorder:
    """Hand recordings to a writer process: `start`, `open`, `rows`, `end`, `finish`, and `pump` again and again.

    Only `finish` waits. A disk that is full, slow or gone ends the recording, not the run. `tell` is called with a line
    for the user when something is not recorded; `about` (configuration, seed, versions) goes into every file.
    """

    def __init__(
        self, tell: Callable[[str], None], *, limit_bytes: int, about: Mapping[str, Any] | None = None
    ) -> None:
        self.process: SideProcess | None = None  # the writer; None before `start`
        self.stopped: str | None = None  # why recording has stopped
        self._fault: str | None = None  # the first recording fault
        self._tell = tell
        self._limit_bytes = limit_bytes
        self._about = dict(about or {})
        self._files = 0
        self._begun = 0
        self._completed: int | None = None  # as reported by the writer
        self._not_recorded = 0
        self._path: Path | None = None  # of the only recording

    @property
    def is_behind(self) -> bool:
        """Whether bytes wait for the writer."""
        return self.process is not None and self.process.waiting_bytes > 0

    def start(self) -> None:
        """Start the writer; raise UnavailableError if this fails."""
        self.process = SideProcess("hapticnet.runtime.writer", str(self._limit_bytes))

    def open(
        self, path: Path, side: str, tables: Sequence[Table], unix_offset_us: int, about: Mapping[str, Any]
    ) -> int | None:
        """Begin a recording and return its number; None if there are too many. The main table is the first."""
        suffix = path.suffix.lower()
        files = FILES[suffix] + max(0, len(tables) - 2) * (suffix == ".csv")
        if self._files + files > FILE_LIMIT:
            if not self._not_recorded:
                self._tell(f"the recordings have {FILE_LIMIT:,} files; a session that begins now is not recorded")
            self._not_recorded += 1
            return None
        self._files += files
        self._path = None if self._begun else path.absolute()
        self._begun += 1
        heading = Heading(path.absolute(), side, tuple(tables), unix_offset_us, {**self._about, **about})
        self._put(pack_begin(self._begun, heading))
        return self._begun

    def rows(self, number: int, table: int, numbers: "array[float]") -> None:
        """Record rows as one flat array, which must not change any more."""
        rows = memoryview(numbers).cast("B")
        self._put(pack_rows_header(number, table, rows.nbytes))
        self._put(rows)

    def event(self, number: int, t_us: int, event: object) -> None:
        """Record an event of a node."""
        self._put(pack_frame(FrameKind.EVENT, number, t_us, type(event).__name__, event_text(event)))

    def end(self, number: int, about: Mapping[str, Any]) -> None:
        """Complete a recording; `about` has facts known only now, such as the report."""
        self._put(pack_frame(FrameKind.ABOUT, number, dict(about)))
        self._put(pack_frame(FrameKind.END, number))

    def pump(self) -> None:
        """Pass on as much as the writer accepts now, and read its messages. Does not wait."""
        if self.process is not None:
            self.process.pump()
            self._listen(self.process)

    def finish(self) -> None:
        """Pass on everything and wait until the files are complete, for at most `FINISH_WITHIN_S`."""
        process = self.process
        if process is not None:
            self._listen(process)
            if process.finish(FINISH_WITHIN_S):
                self._listen(process)
                process.close()
            else:
                self.stop(f"the disk is slow; process {process.pid} continues writing", is_fault=True)
        if self._not_recorded:
            self._tell(f"{self._not_recorded:,} sessions were not recorded")

    def check(self) -> None:
        """Raise FileError if a recording could not be written completely. Reaching the limit is no error."""
        if self._fault is not None:
            raise FileError(f"the recordings are incomplete: {self._fault}")

    def report(self) -> dict[str, Any]:
        """Return the report of the recordings for JSON."""
        return {
            "begun": self._begun,
            "completed": self._completed,
            "sessions_not_recorded": self._not_recorded,
            "stopped": self.stopped,
        }

    def stop(self, reason: str, *, is_fault: bool) -> None:
        """Record nothing more, and report why; waiting rows are still written."""
        if is_fault:
            self._fault = self._fault or reason
        if self.stopped is None:
            self.stopped = reason
            self._tell(f"recording stops: {reason}")

    def _put(self, data: bytes | memoryview) -> None:
        process = self.process
        if self.stopped is not None or process is None:
            return
        if process.waiting_bytes + len(data) > MOST_WAITING_BYTES:
            self.stop("the writer cannot keep up; the disk is slow, or the processor busy", is_fault=True)
        else:
            process.put(data)

    def _listen(self, process: SideProcess) -> None:
        code = process.exit_code
        for line in process.said():
            self._hear(process, *json.loads(line))
        if code is not None and self._completed is None and self.stopped is None:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            which = self._path or "FILE"
            self.stop(
                f"its writer process ended ({how}); 'hapticnet export {which}.unfinished' completes what was written",
                is_fault=True,
            )

    def _hear(self, process: SideProcess, kind: str, text: str) -> None:
        if kind == DONE:
            self._completed = int(text)
            if self._completed < self._begun and self.stopped is None:
                self.stop(f"its writer completed {self._completed:,} of {self._begun:,} files", is_fault=True)
        elif kind in (STOPPED, FAILED):
            self.stop(text, is_fault=kind == FAILED)
            process.drop()
        else:
            self._fault = self._fault or text
            self._tell(text)


class _Track:
    """The rows and events of one node, on their way to one file, which begins with the first row."""

    def __init__(self, recorder: Recorder, path: Path, side: str, names: tuple[str, ...]) -> None:
        self._recorder = recorder
        self._path = path
        self._side = side
        self._names = names
        self._number: int | None = None
        self._begun = False
        self._shift_us = 0
        self._early: list[tuple[int, object]] = []

    def collect(
        self, main: Recording | None, others: Sequence[Recording | None], about: Callable[[], Mapping[str, Any]]
    ) -> None:
        """Hand over the rows that were added since the last call."""
        numbers = main.take() if main is not None else None
        if numbers and main is not None and not self._begun:
            self._begin(main.columns, numbers, others, about())
        if not self._begun:
            return
        if numbers and self._number is not None:
            self._recorder.rows(self._number, 0, numbers)
        for table, other in enumerate((each for each in others if each is not None), start=1):
            rows = other.take()  # even if it is not recorded, so that nothing accumulates
            if rows and self._number is not None:
                self._recorder.rows(self._number, table, rows)

    def note(self, event: object, now_us: int) -> None:
        """Record an event; `now_us` is the node's own clock."""
        if self._number is not None:
            self._recorder.event(self._number, now_us + self._shift_us, event)
        elif not self._begun and len(self._early) < MOST_EARLY_EVENTS:
            self._early.append((now_us, event))

    def end(self, about: Mapping[str, Any]) -> None:
        """Complete the file."""
        if self._number is not None:
            self._recorder.end(self._number, about)
            self._number = None

    def _begin(
        self,
        columns: tuple[str, ...],
        numbers: Sequence[float],
        others: Sequence[Recording | None],
        about: Mapping[str, Any],
    ) -> None:
        self._begun = True
        if "answered_us" in columns:
            self._shift_us = round(numbers[columns.index("t_us")] - numbers[columns.index("answered_us")])
        tables = [Table(self._names[0], columns)]
        tables += [
            Table(name, other.columns, shift_us=self._shift_us)
            for name, other in zip(self._names[1:], others, strict=True)
            if other is not None
        ]
        offset_us = unix_offset_us() - self._shift_us
        self._number = self._recorder.open(self._path, self._side, tables, offset_us, about)
        for at_us, event in self._early:
            self.note(event, at_us)
        self._early.clear()


class _Recording(Watcher[Event], Generic[Event]):
    """Hand rows to the writer every `BATCH_S`."""

    name = "recording"

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self._handle: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Begin."""
        self.recorder.start()
        self._handle = asyncio.get_running_loop().call_later(BATCH_S, self._fire)

    async def stop(self) -> None:
        """Complete the files, without blocking the loop."""
        if self._handle is not None:
            self._handle.cancel()
        self._collect_all()
        await asyncio.to_thread(self.recorder.finish)

    def _collect(self) -> bool:
        """Hand over rows; return whether more are due now."""
        raise NotImplementedError

    def _collect_all(self) -> None:
        raise NotImplementedError

    def _fire(self) -> None:
        recorder = self.recorder
        try:
            more = not recorder.is_behind and self._collect()
            recorder.pump()
        except Exception as error:  # a fault of the recorder's own code; the run must continue
            recorder.stop(f"the recorder failed: {in_words(error)}", is_fault=True)
            return
        pause_s = CATCH_UP_S if more or recorder.is_behind else BATCH_S
        self._handle = asyncio.get_running_loop().call_later(pause_s, self._fire)


class MasterRecording(_Recording[NodeEvent]):
    """Record every tick of a master in a file; the node's settings must request that."""

    def __init__(
        self, node: MasterNode, file: Path, say: Callable[[str], None], *, limit_bytes: int,
        about: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(Recorder(say, limit_bytes=limit_bytes, about=about))
        self._node = node
        self._track = _Track(self.recorder, file, "master", ("tick", "datagram", "vibration"))

    def note(self, event: NodeEvent, now_us: int) -> None:
        """Record an event."""
        self._track.note(event, now_us)

    def _collect(self) -> bool:
        node = self._node
        vibration = None if node.vibration is None else node.vibration.recording
        self._track.collect(node.recording, (node.datagrams, vibration), lambda: about_master(node.settings))
        return False

    def _collect_all(self) -> None:
        self._collect()
        self._track.end({"report": self._node.report()})


class SlaveRecording(_Recording[SlaveEvent]):
    """Record every session of a slave in FOLDER/NAME-SESSION and a suffix; the node's settings must request that."""

    def __init__(
        self, node: SlaveNode, folder: Path, say: Callable[[str], None], *, suffix: str, limit_bytes: int,
        channel_out: str | None = None, about: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(Recorder(say, limit_bytes=limit_bytes, about=about))
        self._node = node
        self._channel_out = channel_out
        self._folder = folder
        self._suffix = suffix
        self._tracks: dict[SlaveContext, _Track] = {}
        self._due: list[SlaveContext] = []

    def note(self, event: SlaveEvent, now_us: int) -> None:
        """Record an event; complete the file of a master that has left."""
        if isinstance(event, MasterRefused | StepsTooSlow):  # no session belongs to it
            return
        context = event.context
        if isinstance(event, MasterJoined):
            file = self._folder / f"{file_name(context.session.request.name, context.session.number)}{self._suffix}"
            self._tracks[context] = _Track(self.recorder, file, "slave", ("step", "datagram"))
        track = self._tracks.get(context)
        if track is None:
            return
        if isinstance(event, MasterLeft):
            self._collect_one(context, track)
        track.note(event, now_us)
        if isinstance(event, MasterJoined):
            settings = SettingsInForce.of(context.session.request, context.grant)
            track.note(replace(settings, channel_out=self._channel_out), now_us)
        elif isinstance(event, MasterLeft):
            track.end({"report": context.report()})
            del self._tracks[context]

    def _collect(self) -> bool:
        """Collect only some sessions, because answers wait meanwhile; return whether more of this round are due."""
        self._due = self._due or list(self._tracks)
        now, self._due = self._due[:MOST_AT_ONCE], self._due[MOST_AT_ONCE:]
        for context in now:
            if context in self._tracks:
                self._collect_one(context, self._tracks[context])
        return bool(self._due)

    def _collect_all(self) -> None:
        while self._collect():
            pass

    @staticmethod
    def _collect_one(context: SlaveContext, track: _Track) -> None:
        track.collect(context.recording, (context.datagrams,), lambda: _of_context(context))


def file_name(master: str, session: int) -> str:
    """Return the name of a session's file without suffix."""
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in master) + f"-{session:08x}"


def about_master(settings: MasterSettings) -> dict[str, Any]:
    """Return a master's configuration for its recording, without its key; events state the settings in force."""
    plain = asdict(replace(settings, key=None))
    del plain["key"]
    return {"asked_at_start": plain, "sealed": settings.key is not None, "wire_versions": WIRE_VERSIONS}


def _of_context(context: SlaveContext) -> dict[str, Any]:
    """Return a session's request and grant, without tickets."""
    request, grant = context.session.request._asdict(), context.grant._asdict()
    del request["ticket"], grant["ticket"]
    return {"request": request, "grant": grant, "wire_versions": WIRE_VERSIONS}


def unix_offset_us() -> int:
    """Return the offset from this process's `now_us` to µs since 1970."""
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
