"""The socket of a tool that another program moves: ``--operator udp:[HOST:]PORT``."""

import asyncio
import socket
from collections.abc import Callable

from hapticnet.node.master_events import NodeEvent
from hapticnet.operator.remote import RemoteOperator
from hapticnet.runtime.udp import SocketAddress, UdpPort
from hapticnet.runtime.watching import Watcher


class HandPort(Watcher[NodeEvent]):
    """Pass datagrams to a `RemoteOperator`, and its answers back.

    Positions are read when they arrive. The answer leaves after the tick that sent the position to the slave, so that
    it delays nothing.

    Parameters
    ----------
    sock
        A socket that is bound to the address; `stop` closes it.
    say
        Called with each message for a person.
    """

    name = "udp operator"

    def __init__(self, hand: RemoteOperator, sock: socket.socket, say: Callable[[str], None]) -> None:
        self._hand = hand
        self._sock = sock
        self._say = say
        self._port: UdpPort | None = None

    async def start(self) -> None:
        """Begin to read positions."""
        self._port = UdpPort(asyncio.get_running_loop(), self._sock, self._receive)

    def observe(self, now_us: int) -> None:  # noqa: ARG002 - what all watchers are called with
        """Answer the newest position, if one arrived since the last call."""
        if (reply := self._hand.answer()) is not None and self._port is not None:
            self._port.send(*reply)
        while (line := self._hand.next_line()) is not None:
            self._say(line)

    async def stop(self) -> None:
        """Close the socket."""
        if self._port is not None:
            self._port.close()
            self._port = None
        else:
            self._sock.close()

    def _receive(self, batch: list[tuple[bytes, SocketAddress]], now_us: int) -> None:
        for data, sender in batch:
            self._hand.receive(data, sender, now_us)
