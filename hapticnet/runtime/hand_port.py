"""The socket of a tool that another program moves: ``--operator udp:[HOST:]PORT``."""

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from hapticnet.node.events import NodeEvent
from hapticnet.operator.remote import RemoteOperator
from hapticnet.runtime.system import now_us
from hapticnet.runtime.udp import READ_BYTES
from hapticnet.runtime.watching import Watcher

PERIOD_S: Final = 0.001
MOST_IN_A_PERIOD: Final = 8  # datagrams, 8 µs each, so that a flood delays no tick
BUFFER_BYTES: Final = 16 * 1024  # receive buffer [B] for about 40 positions: even in a flood, they are milliseconds old


class HandPort(Watcher[NodeEvent]):
    """Pass datagrams to a `RemoteOperator`, and its answers back; `say` is called with each message for a person.

    The answer leaves after the tick that sent the position to the slave, so that it delays nothing.
    """

    name = "udp operator"

    def __init__(self, hand: RemoteOperator, sock: socket.socket, say: Callable[[str], None]) -> None:
        self._hand = hand
        self._sock = sock
        self._say = say
        self._period_us = self._count = 0
        self._resume: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Begin to read positions."""
        self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._loop = asyncio.get_running_loop()
        self._listen()

    def observe(self, now_us: int) -> None:  # noqa: ARG002 - what all watchers are called with
        """Answer the newest position, if one arrived since the last call."""
        if (reply := self._hand.answer()) is not None:
            with suppress(OSError):  # the answer counts as lost
                self._sock.sendto(*reply)
        while (line := self._hand.next_line()) is not None:
            self._say(line)

    async def stop(self) -> None:
        """Close the socket."""
        if self._resume is not None:
            self._resume.cancel()
        if self._sock.fileno() >= 0:
            asyncio.get_running_loop().remove_reader(self._sock.fileno())
        self._sock.close()

    def _listen(self) -> None:
        self._resume = None
        self._loop.add_reader(self._sock.fileno(), self._read)

    def _read(self) -> None:
        """Read arrived datagrams, but at most `MOST_IN_A_PERIOD`: the system drops the rest of a flood."""
        now = now_us()
        if now - self._period_us >= PERIOD_S * 1e6:
            self._period_us, self._count = now, 0
        while self._count < MOST_IN_A_PERIOD:
            self._count += 1
            try:
                data, sender = self._sock.recvfrom(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:  # an earlier answer could not be delivered
                continue
            self._hand.receive(data, sender, now)
        self._loop.remove_reader(self._sock.fileno())
        self._resume = self._loop.call_later(PERIOD_S, self._listen)
