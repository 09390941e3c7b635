"""Recordings of master and slave while they run."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hapticnet.node.master import MasterNode, NodeEvent
from hapticnet.node.slave import MasterLeft, SlaveEvent, SlaveNode
from hapticnet.runtime.recorder import Recorder
from hapticnet.runtime.watching import Watcher

if TYPE_CHECKING:
    from hapticnet.node.station import Station


class MasterRecording(Watcher[NodeEvent]):
    """Record every tick of a master in a file."""

    name = "recording"

    def __init__(self, node: MasterNode, file: Path, say: Callable[[str], None], *, limit_bytes: int) -> None:
        self.recorder = Recorder(say, limit_bytes=limit_bytes)
        self._node = node
        self._file = file

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Hand over what was added since the last call."""
        if self._node.recording is not None:
            self.recorder.collect(self._node.recording, self._file)

    async def stop(self) -> None:
        """Hand over the rest."""
        self.check(0)


class SlaveRecording(Watcher[SlaveEvent]):
    """Record every session of a slave in a file of its own in `folder`."""

    name = "recording"

    def __init__(self, node: SlaveNode, folder: Path, say: Callable[[str], None], *, limit_bytes: int) -> None:
        self.recorder = Recorder(say, limit_bytes=limit_bytes)
        self._node = node
        self._folder = folder

    def note(self, event: SlaveEvent, now_us: int) -> None:  # noqa: ARG002
        """Complete the recording of a master that has left."""
        if isinstance(event, MasterLeft):
            self._collect(event.station, ended=True)
        self.recorder.set_idle(not self._node.stations)

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Hand over what was added since the last call."""
        for station in self._node.stations:
            self._collect(station)

    def _collect(self, station: "Station", *, ended: bool = False) -> None:
        if station.recording is None:
            return
        name = "".join(c if c.isalnum() or c in "-_" else "_" for c in station.session.request.name)
        file = self._folder / f"{name}-{station.session.number:08x}.csv"
        self.recorder.collect(station.recording, file)
        if ended:
            self.recorder.end(file)
