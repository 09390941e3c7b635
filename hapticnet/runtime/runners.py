"""A master and a slave in real time: their nodes on an event loop, with socket, timer, serial line and watchers."""

import asyncio
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from socket import socket
from typing import Any, Final, Generic, TypedDict, Unpack

from hapticnet.channel.emulator import Emulator
from hapticnet.node.events import NodeEvent, SlaveEvent
from hapticnet.node.master import MasterNode
from hapticnet.node.slave import SlaveNode
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.recorder import Recorder
from hapticnet.runtime.serial_port import Wire, open_wire
from hapticnet.runtime.signals import Rescue, SignalHandler, stop_on_signals
from hapticnet.runtime.system import now_us, waited_us
from hapticnet.runtime.timer import Alarm, Repeating, Ticker, either, until
from hapticnet.runtime.udp import IncomingChannel, OutgoingChannel, SocketAddress, UdpPort
from hapticnet.runtime.watching import Event, Watcher, Watchers

PARTING_S: Final = 1.0  # longest time [s] that a process waits for its last datagrams to leave its emulated channel
POLL_S: Final = 0.1  # time [s] between two checks whether the last master has left


class Around(TypedDict, Generic[Event], total=False):
    """The surroundings of a running node; all optional."""

    channel: OutgoingChannel | None  # emulated network for outgoing datagrams
    watchers: Sequence[Watcher[Event]]
    overload: Overload | None
    tell: Callable[[str], None]  # called with a line for the user when a watcher fails


class _Runner(Generic[Event]):
    """Common base of a master and a slave on the running event loop."""

    def __init__(
        self,
        sock: socket,
        channel: OutgoingChannel | None = None,
        watchers: Sequence[Watcher[Event]] = (),
        overload: Overload | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._sock = sock
        self._channel = channel
        self._watchers = Watchers(watchers, tell)
        self._overload = overload

    def _check_others(self, now: int) -> None:
        self._watchers.check(now)
        if self._overload is not None:
            self._overload.check(now)


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterRun:
    """Figures of a master's run in real time, for its report.

    `end_reason` is None while it runs, `missed_ticks` if the program drives the ticks, `port_…` without a serial port.
    """

    end_reason: str | None
    connected: bool
    lateness: dict[str, object]
    missed_ticks: int | None
    send_errors: int
    unknown_peers: int
    port_openings: int | None
    port_unwritten_bytes: int | None


class MasterRunner(_Runner[NodeEvent]):
    """A master node on the running event loop, with `wire` for a wired device. It does not touch signals.

    Others set `stop` to end the run; it is set here when the session has ended.
    """

    def __init__(
        self,
        node: MasterNode,
        sock: socket,
        slave: SocketAddress,
        *,
        stop: asyncio.Event,
        wire: Wire | None = None,
        channel_in: IncomingChannel | None = None,
        **around: Unpack[Around[NodeEvent]],
    ) -> None:
        super().__init__(sock, **around)
        self.node = node
        self.connected = asyncio.Event()  # set once there has been a session
        self._ended = asyncio.Event()
        self._stop = stop
        self._slave = slave
        self._wire = wire
        self._channel_in = channel_in

    @property
    def missed_ticks(self) -> int:
        """Ticks skipped so far, because the next was already due."""
        return self._ticker.missed

    async def start(self) -> None:
        """Open the device and begin to tick; raises as `open_wire`. Later the device may be unplugged and replugged."""
        loop = asyncio.get_running_loop()
        self._serial = await open_wire(self._wire, self._stop) if self._wire is not None else None
        try:
            await self._watchers.start()
        except BaseException:
            if self._serial is not None:
                await self._serial.stop()
            raise
        self._port = UdpPort(
            loop, self._sock, self._receive, at_once=True, peer=self._slave, channel=self._channel,
            channel_in=self._channel_in,
        )  # fmt: skip
        self._ticker = Ticker(loop, self.node.period_us, self._tick)
        if self._overload is not None:
            self._overload.attach(self._port, self._ticker, self.node.times)
        self._status = Repeating(loop, self._check)

    async def finish(self, reason: str) -> MasterRun:
        """Close the session, stop the ticks and return the figures of the run."""
        try:
            self.node.close(reason, now_us())
            self._flush()
            await self._ended.wait()
            await self._port.drained(PARTING_S)
        finally:
            self._status.cancel()
            self._ticker.stop()
            self._port.close()
            await self._watchers.stop()
            if self._serial is not None:
                await self._serial.stop()
        return self.account(reason)

    def account(self, end_reason: str | None) -> MasterRun:
        """Return the figures of the run so far."""
        return MasterRun(
            end_reason=end_reason,
            connected=self.connected.is_set(),
            lateness=self._ticker.lateness.report(),
            missed_ticks=self._ticker.missed,
            send_errors=self._port.send_errors,
            unknown_peers=self._port.unknown_peers,
            port_openings=self._serial.openings if self._serial is not None else None,
            port_unwritten_bytes=self._serial.unwritten if self._serial is not None else None,
        )

    def _receive(self, batch: list[tuple[bytes, SocketAddress]], now: int) -> None:
        for data, _ in batch:
            self.node.receive_datagram(data, now)
        self._flush()

    def _tick(self, now: int) -> None:
        node = self.node
        node.tick(now)
        self._flush()  # the position first: while the slave computes its answer, this process moves the device
        node.drive(now)
        if self._serial is not None:
            self._serial.flush(now)
        if self._watchers.observers:
            self._watchers.observe(now)

    def _check(self) -> None:
        now = now_us()
        self.node.check(now, waited_us)
        self._flush()
        self._check_others(now)

    def _flush(self) -> None:
        node = self.node
        for data in node.datagrams_to_send():
            self._port.send(data, self._slave)
        if node.connected:
            self.connected.set()
        if node.finished:
            self._ended.set()
            self._stop.set()
        while (event := node.next_event()) is not None:
            self._watchers.note(event, now_us())


class SlaveRunner(_Runner[SlaveEvent]):
    """A slave node on the running event loop; it has no tick, and steps a scene when a position arrives."""

    def __init__(self, node: SlaveNode, sock: socket, **around: Unpack[Around[SlaveEvent]]) -> None:
        super().__init__(sock, **around)
        self.node = node

    async def start(self) -> None:
        """Begin to answer."""
        loop = asyncio.get_running_loop()
        await self._watchers.start()
        self._alarm = Alarm(loop, self._ring)
        self._port = UdpPort(loop, self._sock, self._receive, channel=self._channel)
        if self._overload is not None:
            self._overload.attach(self._port, times=self.node.times)
        self._status = Repeating(loop, self._check)

    async def finish(self, reason: str) -> None:
        """End every session and stop."""
        self._status.cancel()
        self.node.close(reason, now_us())
        self.flush()
        await self._port.drained(PARTING_S)
        self._alarm.stop()
        self._port.close()
        await self._watchers.stop()

    async def drain(self, stop: asyncio.Event, within_s: float) -> None:
        """Take no new masters, and wait until the present ones have finished, `stop` is set, or for `within_s` [s]."""
        self.node.drain(now_us())
        self._settle()
        end_us = now_us() + round(within_s * 1e6)
        while not self.node.drained and (left_us := end_us - now_us()) > 0:
            if await until(stop, min(POLL_S, left_us / 1e6)):
                return

    def flush(self) -> None:
        """Send the node's datagrams and report its events; call this after changing the node."""
        for data, address in self.node.datagrams_to_send():
            self._port.send(data, address)
        self._alarm.set(self.node.next_timer_us())
        while (event := self.node.next_event()) is not None:
            self._watchers.note(event, now_us())

    def _receive(self, batch: list[tuple[bytes, SocketAddress]], now: int) -> None:
        self.node.receive_datagrams(batch, now)
        self._answer(now)

    def _answer(self, now: int) -> None:
        self.flush()
        self.node.account_sent(now)
        self.flush()
        if self._watchers.observers:
            self._watchers.observe(now)

    def _ring(self) -> None:
        now = now_us()
        self.node.tick(now)
        self._answer(now)

    def _check(self) -> None:
        now = now_us()
        self.node.check(now, waited_us)
        self._settle()
        self._check_others(now)

    def _settle(self) -> None:
        """Send the node's other datagrams, and account for them."""
        self.flush()
        self.node.account_sent(now_us())
        self.flush()


async def run_master(
    node: MasterNode,
    sock: socket,
    slave: SocketAddress,
    *,
    wire: Wire | None = None,
    channel_in: IncomingChannel | None = None,
    duration_s: float | None = None,
    connect_timeout_s: float | None = None,
    stop: asyncio.Event | None = None,
    rescue: Rescue | None = None,
    **around: Unpack[Around[NodeEvent]],
) -> MasterRun:
    """Run until `stop` (default: a signal), a refusal, or `duration_s` [s] after connecting; close the session."""
    stop = stop or stop_on_signals(asyncio.get_running_loop(), rescue)
    runner = MasterRunner(node, sock, slave, stop=stop, wire=wire, channel_in=channel_in, **around)
    await runner.start()
    reason = "stopped"
    try:
        if not await either(runner.connected, stop, connect_timeout_s):
            reason = "no slave answered"
        elif not stop.is_set() and duration_s is not None:
            await until(stop, duration_s)
            reason = "done"
        else:
            await stop.wait()
        if stop.is_set():
            reason = node.end_reason or "stopped"
    finally:
        run = await runner.finish(reason)
    return run


async def run_slave(
    node: SlaveNode,
    sock: socket,
    *,
    duration_s: float | None = None,
    drain_s: float = 0.0,
    on_listening: Callable[[], None] | None = None,
    on_hangup: Callable[[], None] | None = None,
    stop: asyncio.Event | None = None,
    rescue: Rescue | None = None,
    **around: Unpack[Around[SlaveEvent]],
) -> None:
    """Serve until `stop` is set or `duration_s` [s] have passed, then close every session.

    Masters have `drain_s` [s] to finish first; `stop`, or a second signal, ends this. Without a `stop`, signals end
    the run, and `on_hangup` is called at each SIGHUP; `on_listening` once datagrams and signals are handled.
    """
    loop = asyncio.get_running_loop()
    runner = SlaveRunner(node, sock, **around)
    await runner.start()

    def hang_up() -> None:
        if on_hangup is not None:
            on_hangup()
            runner.flush()

    again = asyncio.Event()
    if stop is None:
        stop = stop_on_signals(loop, rescue, again)
        if on_hangup is not None:
            SignalHandler(loop, hang_up).take(signal.SIGHUP)
    try:
        if on_listening is not None:
            on_listening()
        stopped = await until(stop, duration_s)
        if drain_s and not node.drained:
            await runner.drain(again if stopped else stop, drain_s)
    finally:
        await runner.finish("shutting down")


def master_report(
    node: MasterNode,
    run: MasterRun | None,
    overload: Overload,
    *,
    faults: Sequence[str] = (),
    operator: Mapping[str, Any] | None = None,
    recorder: Recorder | None = None,
    channel_out: Emulator[Any] | None = None,
    channel_in: Emulator[Any] | None = None,
) -> dict[str, Any]:
    """Return the report of a master for JSON; missing values are None. `run` is None for a run without end."""
    return {
        "scheduling": overload.scheduling,
        **node.report(),
        **(dict.fromkeys(MasterRun.__dataclass_fields__) if run is None else asdict(run)),
        "overload": overload.report(),
        "faults": [*map(str, node.times.reported), *faults],
        "operator": operator,
        "recording": None if recorder is None else recorder.report(),
        "channel_out": _channel_report(channel_out),
        "channel_in": _channel_report(channel_in),
    }


def slave_report(
    node: SlaveNode,
    overload: Overload,
    *,
    faults: Sequence[str] = (),
    recorder: Recorder | None = None,
    channel_out: Emulator[Any] | None = None,
) -> dict[str, Any]:
    """Return the report of a slave for JSON; missing values are None."""
    return {
        "scheduling": overload.scheduling,
        **node.report(),
        "overload": overload.report(),
        "faults": [*map(str, node.times.reported), *faults],
        "recording": None if recorder is None else recorder.report(),
        "channel_out": _channel_report(channel_out),
    }


def _channel_report(channel: Emulator[Any] | None) -> dict[str, Any] | None:
    """Return the counters of an emulated channel, with its settings at the end; None without one."""
    return None if channel is None else {"settings": channel.settings.describe(), **asdict(channel.counters)}
