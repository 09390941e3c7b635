"""A slave in real time: its node on an event loop, with socket, alarm and watchers."""

import asyncio
import signal
from collections.abc import Callable, Sequence
from socket import socket
from typing import Final

from hapticnet.node.slave import SlaveNode
from hapticnet.node.slave_events import SlaveEvent
from hapticnet.runtime.master_run import PARTING_S
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.signals import Rescue, SignalHandler, stop_on_signals
from hapticnet.runtime.system import now_us, waited_us
from hapticnet.runtime.timer import Alarm, Repeating, until
from hapticnet.runtime.udp import OutgoingChannel, SocketAddress, UdpPort
from hapticnet.runtime.watching import Watcher, Watchers

POLL_S: Final = 0.1
"""Time [s] between two looks whether the last master has left."""


class SlaveRunner:
    """A slave node at work on the running event loop. It leaves signals alone.

    The slave has no tick: it steps a scene when a position arrives, so that the answer is not delayed.

    Parameters
    ----------
    channel
        Emulated network for outgoing datagrams, or None.
    tell
        Called with a line for the user if a watcher fails.
    """

    def __init__(
        self,
        node: SlaveNode,
        sock: socket,
        *,
        channel: OutgoingChannel | None = None,
        watchers: Sequence[Watcher[SlaveEvent]] = (),
        overload: Overload | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.node = node
        self._sock = sock
        self._channel = channel
        self._watchers = Watchers(watchers, tell)
        self._overload = overload

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
        """Send what the node has to send and report its events; call this after changing something at the node."""
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
        self._watchers.check(now)
        if self._overload is not None:
            self._overload.check(now)

    def _settle(self) -> None:
        """Send what the node has to say besides answers; then those that said it may go on as before."""
        self.flush()
        self.node.account_sent(now_us())
        self.flush()


async def run_slave(
    node: SlaveNode,
    sock: socket,
    *,
    channel: OutgoingChannel | None = None,
    duration_s: float | None = None,
    drain_s: float = 0.0,
    watchers: Sequence[Watcher[SlaveEvent]] = (),
    overload: Overload | None = None,
    tell: Callable[[str], None] = lambda _: None,
    on_listening: Callable[[], None] | None = None,
    on_hangup: Callable[[], None] | None = None,
    stop: asyncio.Event | None = None,
    rescue: Rescue | None = None,
) -> None:
    """Serve until `stop` is set or `duration_s` [s] have passed, then close every session.

    Before, masters have `drain_s` [s] to finish; `stop`, or a second signal, ends this.

    Without a `stop`, SIGINT and SIGTERM end the run, and `on_hangup` is called at each SIGHUP; with one, signals are
    left to the host program. `rescue` ends a run that is stuck then. `on_listening` is called when datagrams and
    signals are answered.
    """
    loop = asyncio.get_running_loop()
    runner = SlaveRunner(node, sock, channel=channel, watchers=watchers, overload=overload, tell=tell)
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
