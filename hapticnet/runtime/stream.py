"""``--stream``: every sample as a JSON datagram for PlotJuggler, sent by a process of its own.

PlotJuggler's "UDP Server" (port 9870, protocol "json") reads one message per datagram, of at most 2,048 bytes, and
takes the time in seconds from the field ``timestamp``. A message that is not valid makes it stop.
"""

import asyncio
import json
import time
from array import array
from collections.abc import Callable
from typing import Final, Generic

from hapticnet.node.master import MasterNode
from hapticnet.node.master_events import NodeEvent
from hapticnet.node.recording import axis_columns, master_columns
from hapticnet.node.slave import SlaveNode
from hapticnet.node.slave_events import MasterLeft, SlaveEvent
from hapticnet.node.station import Station
from hapticnet.protocol.wire import Kind
from hapticnet.runtime.side_process import SideProcess
from hapticnet.runtime.udp import HostPort, open_toward
from hapticnet.runtime.watching import Event, Watcher

FLUSH_S: Final = 0.05
"""Time [s] between two batches on the way to the sending process."""

LARGEST_ROWS: Final = 1 << 16
"""Numbers kept of a series until the next batch; more come only from a loop that has stopped."""

DEFINE: Final = 0
"""Kind of a frame that defines a series: JSON with its number, path, columns and offset_s."""

ROWS: Final = 1
"""Kind of a frame with samples: the number of the series as a double, then rows of doubles, t_us first."""

MODULE: Final = "hapticnet.runtime.stream_sender"


class Series:
    """The samples of one source, on their way to the sending process.

    Parameters
    ----------
    path
        What PlotJuggler shows above the columns.
    offset_s
        What to add to the time of its samples [s] for Unix time.

    Attributes
    ----------
    definition
        The body of the frame that defines it; None once that has been sent.
    """

    def __init__(self, number: int, path: tuple[str, ...], columns: tuple[str, ...], offset_s: float) -> None:
        definition = {"series": number, "path": path, "columns": columns, "offset_s": offset_s}
        self.definition: bytes | None = json.dumps(definition).encode()
        self.number = number
        self._numbers = array("d", (number,))

    def add(self, row: tuple[float, ...]) -> None:
        """Append a sample: t_us, then one number per column."""
        if len(self._numbers) < LARGEST_ROWS:
            self._numbers.extend(row)

    def take(self) -> bytes:
        """Return the samples since the last call as the body of a frame; empty if there are none."""
        if len(self._numbers) == 1:
            return b""
        numbers, self._numbers = self._numbers, array("d", (self.number,))
        return numbers.tobytes()


class Stream(Watcher[Event], Generic[Event]):
    """Base of the streams of master and slave.

    Parameters
    ----------
    target
        Where the datagrams go; the host is looked up at once.
    tell
        Called with a line for the user if samples are left out.
    fault
        Called with a line for the user if the sending process fails.

    Raises
    ------
    UnavailableError
        If there is no such host.
    """

    name = "stream"

    def __init__(self, target: HostPort, tell: Callable[[str], None], fault: Callable[[str], None]) -> None:
        self._fault = fault
        self._socket, (host, port, *_) = open_toward(target)
        self._arguments = str(host), str(port)
        self._tell = tell
        self._told = False
        self._series: dict[object, Series] = {}
        self._count = 0
        self._process: SideProcess | None = None
        self._timer: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Start the sending process."""
        self._process = SideProcess(
            MODULE, [self._socket.fileno()], self._arguments, name="the process of --stream", tell=self._fault
        )
        self._socket.close()
        self._schedule()

    async def stop(self) -> None:
        """Send what is left."""
        if self._timer is not None:
            self._timer.cancel()
        if self._process is not None:
            self._flush()
            await self._process.stop()

    def _define(self, key: object, path: tuple[str, ...], columns: tuple[str, ...], t_us: int) -> Series:
        """Return a new series; `t_us` is the present time on the clock of its samples."""
        series = self._series[key] = Series(self._count, path, columns, time.time() - t_us / 1e6)
        self._count += 1
        return series

    def _schedule(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(FLUSH_S, self._fire)

    def _fire(self) -> None:
        self._schedule()
        self._flush()

    def _flush(self) -> None:
        process = self._process
        if process is None:
            return
        for series in self._series.values():
            if series.definition is not None and process.send(DEFINE, series.definition):
                series.definition = None
            if series.definition is None and (rows := series.take()):
                process.send(ROWS, rows)
        if process.left_out and not self._told:
            self._told = True
            self._tell("--stream cannot keep up and leaves samples out")


class MasterStream(Stream[NodeEvent]):
    """Stream every tick of a master: ``master/position_m``, ``master/held_n`` and so on."""

    def __init__(
        self, node: MasterNode, target: HostPort, tell: Callable[[str], None], fault: Callable[[str], None]
    ) -> None:
        super().__init__(target, tell, fault)
        self._node = node
        self._own: Series | None = None

    def observe(self, now_us: int) -> None:
        """Take down a tick."""
        node = self._node
        if node.position_m is None:
            return
        if self._own is None:
            columns = (*master_columns(node.axes)[1:], "forces_received")
            self._own = self._define(None, (node.settings.name,), columns, now_us)
        self._own.add(
            (
                now_us, *node.position_m, *node.received_n, *node.held_n, node.target_n, node.sensed_n,
                node.displacement_m, node.session.received.by_kind[Kind.FORCE],
            )
        )  # fmt: skip


class SlaveStream(Stream[SlaveEvent]):
    """Stream every step of a slave's scenes: ``slave/NAME/force_n`` for the true force, and so on."""

    def __init__(
        self, node: SlaveNode, target: HostPort, tell: Callable[[str], None], fault: Callable[[str], None]
    ) -> None:
        super().__init__(target, tell, fault)
        self._node = node
        self._steps: dict[int, int] = {}

    def observe(self, now_us: int) -> None:  # noqa: ARG002 - samples have their own time
        """Take down the newest step of each session."""
        for station in self._node.stations:
            newest = station.newest
            if newest is None or self._steps.get(station.session.number) == station.steps:
                continue
            self._steps[station.session.number] = station.steps
            t_us, position_m, force_n, held_n, transmitted = newest
            series = self._series.get(station.session.number) or self._begin(station, t_us)
            series.add((t_us, *position_m, *force_n, *held_n, transmitted))

    def note(self, event: SlaveEvent, now_us: int) -> None:  # noqa: ARG002
        """Forget a session that has ended."""
        if isinstance(event, MasterLeft):
            self._flush()
            number = event.station.session.number
            self._series.pop(number, None)
            self._steps.pop(number, None)

    def _begin(self, station: Station, t_us: int) -> Series:
        axes = station.scene.axes
        vectors = (("position", "m"), ("force", "n"), ("held", "n"))
        columns = [column for quantity, unit in vectors for column in axis_columns(quantity, unit, axes)]
        path = "slave", station.session.request.name
        return self._define(station.session.number, path, (*columns, "transmitted"), t_us)
