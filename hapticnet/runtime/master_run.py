"""A master in real time: its node on an event loop, with socket, timer, serial line and watchers."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from socket import socket

from hapticnet.node.master import MasterNode
from hapticnet.node.master_events import NodeEvent
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.serial_port import Wire, open_wire
from hapticnet.runtime.signals import Rescue, stop_on_signals
from hapticnet.runtime.system import now_us, waited_us
from hapticnet.runtime.timer import Repeating, Ticker, either, until
from hapticnet.runtime.udp import IncomingChannel, OutgoingChannel, SocketAddress, UdpPort
from hapticnet.runtime.watching import Watcher, Watchers

PARTING_S = 1.0
"""Longest time [s] that a process waits for its last datagrams to leave its emulated channel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterRun:
    """Account of a master's run in real time, for its report.

    `end_reason` is None while it runs, `missed_ticks` if the program has the timer, `port_…` without a serial port.
    """

    end_reason: str | None
    connected: bool
    lateness: dict[str, object]
    missed_ticks: int | None
    send_errors: int
    unknown_peers: int
    port_openings: int | None
    port_unwritten_bytes: int | None


class MasterRunner:
    """A master node at work on the running event loop. It leaves signals alone.

    Parameters
    ----------
    slave
        Address of the slave.
    wire
        The serial line of a wired device, or None.
    channel, channel_in
        Emulated networks for outgoing and for arriving datagrams, or None.
    tell
        Called with a line for the user if a watcher fails.
    stop
        Set from elsewhere to end the run; set here when the session has ended.

    Attributes
    ----------
    connected
        Set when there has been a session.
    """

    def __init__(
        self,
        node: MasterNode,
        sock: socket,
        slave: SocketAddress,
        *,
        stop: asyncio.Event,
        wire: Wire | None = None,
        channel: OutgoingChannel | None = None,
        channel_in: IncomingChannel | None = None,
        watchers: Sequence[Watcher[NodeEvent]] = (),
        overload: Overload | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.node = node
        self.connected = asyncio.Event()
        self._ended = asyncio.Event()
        self._stop = stop
        self._sock = sock
        self._slave = slave
        self._wire = wire
        self._channels = channel, channel_in
        self._watchers = Watchers(watchers, tell)
        self._overload = overload

    @property
    def missed_ticks(self) -> int:
        """Ticks left out so far, because the next was already due."""
        return self._ticker.missed

    async def start(self) -> None:
        """Open the device and begin to tick.

        A device on a wire must be present now; later it may be unplugged and replugged.

        Raises
        ------
        UnavailableError
            If there is no such port, or no device answers on it.
        RefusedError
            If the device speaks a different protocol version.
        """
        loop = asyncio.get_running_loop()
        self._serial = await open_wire(self._wire, self._stop) if self._wire is not None else None
        try:
            await self._watchers.start()
        except BaseException:
            if self._serial is not None:
                await self._serial.stop()
            raise
        channel, channel_in = self._channels
        self._port = UdpPort(
            loop, self._sock, self._receive, at_once=True, peer=self._slave, channel=channel, channel_in=channel_in
        )
        self._ticker = Ticker(loop, self.node.period_us, self._tick)
        if self._overload is not None:
            self._overload.attach(self._port, self._ticker, self.node.times)
        self._status = Repeating(loop, self._check)

    async def finish(self, reason: str) -> MasterRun:
        """Close the session, stop the ticks and return the account of the run."""
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
        """Return the account of the run so far."""
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
        self._watchers.check(now)
        if self._overload is not None:
            self._overload.check(now)

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


async def run_master(
    node: MasterNode,
    sock: socket,
    slave: SocketAddress,
    *,
    wire: Wire | None = None,
    channel: OutgoingChannel | None = None,
    channel_in: IncomingChannel | None = None,
    duration_s: float | None = None,
    connect_timeout_s: float | None = None,
    watchers: Sequence[Watcher[NodeEvent]] = (),
    overload: Overload | None = None,
    tell: Callable[[str], None] = lambda _: None,
    stop: asyncio.Event | None = None,
    rescue: Rescue | None = None,
) -> MasterRun:
    """Run until `stop` is set, a refusal, or `duration_s` [s] after the first connection; then close the session.

    Without a `stop`, SIGINT and SIGTERM end the run; with one, signals are left to the host program. `rescue`
    ends a run that is stuck then. The other parameters, and the errors, are those of `MasterRunner`.
    """
    stop = stop or stop_on_signals(asyncio.get_running_loop(), rescue)
    runner = MasterRunner(
        node, sock, slave, stop=stop, wire=wire, channel=channel, channel_in=channel_in, watchers=watchers,
        overload=overload, tell=tell,
    )  # fmt: skip
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
