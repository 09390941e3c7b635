"""HELLOs on their way from one worker to another, over local sockets."""

import asyncio
import socket
from collections.abc import Callable, Sequence
from typing import Final

import msgpack

from hapticnet.node.neighbours import PassedOn, Stage
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES

READ_BYTES: Final = MAX_DATAGRAM_BYTES + 256

READ_AT_MOST: Final = 32
"""HELLOs read in a row, so that positions do not wait for many of them."""


class Exchange:
    """Give HELLOs to other workers and take theirs.

    What a worker does not take is lost, as it might be on the network: the master asks again.

    Parameters
    ----------
    inbox
        The end at which this worker reads.
    outboxes
        Of each worker, the end at which the others write.

    Attributes
    ----------
    left_out
        HELLOs that found no room.
    """

    def __init__(self, inbox: socket.socket, outboxes: Sequence[socket.socket]) -> None:
        self.left_out = 0
        self._inbox = inbox
        self._outboxes = outboxes
        self._loop: asyncio.AbstractEventLoop | None = None

    def start(self, loop: asyncio.AbstractEventLoop, receive: Callable[[PassedOn], None]) -> None:
        """Begin to read; `receive` is called with each HELLO."""
        self._loop = loop
        loop.add_reader(self._inbox.fileno(), self._read, receive)

    def stop(self) -> None:
        """Stop reading."""
        if self._loop is not None:
            self._loop.remove_reader(self._inbox.fileno())

    def send(self, hellos: Sequence[PassedOn]) -> None:
        """Give HELLOs to the workers they are for."""
        for hello in hellos:
            try:
                self._outboxes[hello.worker].send(msgpack.packb((int(hello.stage), hello.data, hello.address)))
            except OSError:
                self.left_out += 1

    def _read(self, receive: Callable[[PassedOn], None]) -> None:
        for _ in range(READ_AT_MOST):
            try:
                stage, data, address = msgpack.unpackb(self._inbox.recv(READ_BYTES), use_list=False)
            except BlockingIOError:
                return
            receive(PassedOn(-1, Stage(stage), data, address))


def mailboxes(count: int) -> tuple[list[socket.socket], list[socket.socket]]:
    """Return the ends of `count` workers: where each reads, and where the others write to it."""
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(count)]
    for sock in (sock for pair in pairs for sock in pair):
        sock.setblocking(False)
    return [inbox for inbox, _ in pairs], [outbox for _, outbox in pairs]
