"""The slave and master processes: nodes in real time until a signal or the end."""

import asyncio
import signal
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from hapticnet.node.master import MasterNode, NodeEvent
from hapticnet.node.slave import SlaveEvent, SlaveNode
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.serial_port import Wire, open_wire
from hapticnet.runtime.timer import Alarm, Ticker
from hapticnet.runtime.udp import OutgoingChannel, SocketAddress, UdpPort

STATUS_INTERVAL_S: Final = 0.5

PARTING_S: Final = 1.0
"""Longest time [s] that a process waits for its last datagrams to leave its emulated channel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterRun:
    """Account of a master's run in real time, for its report; `port_…` is None without a serial port."""

    end_reason: str
    connected: bool
    lateness: dict[str, object]
    missed_ticks: int
    send_errors: int
    strangers: int
    port_openings: int | None
    port_unwritten_bytes: int | None


async def run_slave(
    node: SlaveNode,
    sock: socket.socket,
    *,
    channel: OutgoingChannel | None,
    duration_s: float | None,
    on_event: Callable[[SlaveEvent], None],
    on_status: Callable[[], None],
    overload: Overload | None = None,
    on_listening: Callable[[], None] | None = None,
    on_hangup: Callable[[], None] | None = None,
    stop: asyncio.Event | None = None,
) -> None:
    """Serve until `stop` is set or `duration_s` [s] have passed, then close every session.

    Without a `stop`, SIGINT and SIGTERM end the run, and `on_hangup` is called at each SIGHUP; with one, signals are
    left to the host program. `on_listening` is called when datagrams and signals are answered.

    The slave has no tick: it steps a scene when a position arrives, so that the answer is not delayed.
    """
    loop = asyncio.get_running_loop()

    def receive(batch: list[tuple[bytes, SocketAddress]], now: int) -> None:
        node.receive_datagrams(batch, now)
        flush()
        node.settle(now)
        flush()

    def hang_up() -> None:
        if on_hangup is not None:
            on_hangup()
            flush()

    def flush() -> None:
        for data, address in node.datagrams_to_send():
            port.send(data, address)
        alarm.set(node.next_timer_us())
        while (event := node.next_event()) is not None:
            on_event(event)

    def ring() -> None:
        node.tick(now_us())
        flush()

    alarm = Alarm(loop, ring)
    port = UdpPort(loop, sock, receive, channel=channel)
    if overload is not None:
        overload.attach(port)
    status = Repeating(loop, on_status, overload)
    if stop is None:
        stop = stop_on_signals(loop)
        if on_hangup is not None:
            loop.add_signal_handler(signal.SIGHUP, hang_up)
    if on_listening is not None:
        on_listening()
    try:
        await until(stop, duration_s)
    finally:
        status.cancel()
        node.close("shutting down", now_us())
        flush()
        await port.drained(PARTING_S)
        alarm.stop()
        port.close()


async def run_master(
    node: MasterNode,
    sock: socket.socket,
    slave: SocketAddress,
    *,
    wire: Wire | None,
    channel: OutgoingChannel | None,
    duration_s: float | None,
    connect_timeout_s: float | None,
    on_event: Callable[[NodeEvent], None],
    on_status: Callable[[], None],
    overload: Overload | None = None,
    stop: asyncio.Event | None = None,
) -> MasterRun:
    """Run until `stop` is set, a refusal, or `duration_s` [s] after the first connection; then close the session.

    Without a `stop`, SIGINT and SIGTERM end the run; with one, signals are left to the host program.

    A device on a `wire` must be present at the start; later it may be unplugged and replugged.

    Raises
    ------
    UnavailableError
        If there is no such port, or no device answers on it.
    RefusedError
        If the device speaks a different protocol version.
    """
    loop = asyncio.get_running_loop()
    stop = stop or stop_on_signals(loop)
    ended = asyncio.Event()
    connected = asyncio.Event()

    def receive(batch: list[tuple[bytes, SocketAddress]], now: int) -> None:
        for data, _ in batch:
            node.receive_datagram(data, now)
        flush()

    def tick(now: int) -> None:
        node.drive(now)
        if serial is not None:
            serial.flush(now)
        # The position is sampled last and sent at once: then this process sleeps, and the slave can run on a warm core.
        node.tick(now_us())
        flush()

    def flush() -> None:
        for data in node.datagrams_to_send():
            port.send(data, slave)
        if node.connected:
            connected.set()
        if node.finished:
            ended.set()
            stop.set()
        if node.period_us != ticker.period_us:
            ticker.set_period(node.period_us)
        while (event := node.next_event()) is not None:
            on_event(event)

    serial = await open_wire(wire, stop) if wire is not None else None
    port = UdpPort(loop, sock, receive, at_once=True, peer=slave, channel=channel)
    ticker = Ticker(loop, node.period_us, tick)
    if overload is not None:
        overload.attach(port, ticker)
    status = Repeating(loop, on_status, overload)
    reason = "done"
    try:
        if not await either(connected, stop, connect_timeout_s):
            reason = "no slave answered"
        elif not stop.is_set() and duration_s is not None:
            await until(stop, duration_s)
        else:
            await stop.wait()
        if stop.is_set():
            reason = node.end_reason or "stopped"
        node.close(reason, now_us())
        flush()
        await ended.wait()
        await port.drained(PARTING_S)
    finally:
        status.cancel()
        ticker.stop()
        port.close()
        if serial is not None:
            await serial.stop()
    return MasterRun(
        end_reason=reason,
        connected=connected.is_set(),
        lateness=ticker.lateness.report(),
        missed_ticks=ticker.missed,
        send_errors=port.send_errors,
        strangers=port.strangers,
        port_openings=serial.openings if serial is not None else None,
        port_unwritten_bytes=serial.unwritten if serial is not None else None,
    )


def stop_on_signals(loop: asyncio.AbstractEventLoop) -> asyncio.Event:
    """Return an event that SIGINT and SIGTERM set."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    return stop


async def until(event: asyncio.Event, timeout_s: float | None) -> bool:
    """Wait for an event for at most `timeout_s` [s]; return whether it was set."""
    try:
        await asyncio.wait_for(event.wait(), timeout_s)
    except TimeoutError:
        return False
    return True


async def either(one: asyncio.Event, other: asyncio.Event, timeout_s: float | None) -> bool:
    """Wait for either of two events for at most `timeout_s` [s]; return whether one was set."""
    waits = [asyncio.ensure_future(event.wait()) for event in (one, other)]
    done, pending = await asyncio.wait(waits, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    for wait in pending:
        wait.cancel()
    return bool(done)


class Repeating:
    """Call a function, and check for overload, every `STATUS_INTERVAL_S` until cancelled."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None], overload: Overload | None = None
    ) -> None:
        self._loop = loop
        self._callback = callback
        self._overload = overload
        self._handle = loop.call_later(STATUS_INTERVAL_S, self._fire)

    def cancel(self) -> None:
        """Stop the calls."""
        self._handle.cancel()

    def _fire(self) -> None:
        if self._overload is not None:
            self._overload.check(now_us())
        self._callback()
        self._handle = self._loop.call_later(STATUS_INTERVAL_S, self._fire)
