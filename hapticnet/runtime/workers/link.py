"""The line between a worker and its parent: frames of JSON over a socket pair. Its end tells that the other is gone."""

import asyncio
import json
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import IntEnum
from typing import Any

from hapticnet.runtime.frames import HEADER, pack_frame


class Say(IntEnum):
    """Kinds of frames."""

    SET_UP = 0
    """To the worker: what it needs to begin."""

    STOP = 1
    """To the worker: end every session and report."""

    READ_AGAIN = 2
    """To the worker: read the list of masters again."""

    READY = 3
    """It serves."""

    NEWS = 4
    """Its present figures."""

    REPORT = 5
    """Its account, at its end."""

    FAILED = 6
    """It cannot begin: why, and the exit code."""


class WorkerLine:
    """The worker's end. It never waits for the parent while sessions are served.

    Parameters
    ----------
    sock
        One end of a socket pair.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._arrived = bytearray()
        self._rest = b""

    def set_up(self) -> Any:
        """Wait for what is needed to begin, and return it; EOFError if the parent is gone."""
        while (frame := self._frame()) is None:
            data = self._socket.recv(1 << 16)
            if not data:
                raise EOFError
            self._arrived += data
        return frame[1]

    def listen(self, loop: asyncio.AbstractEventLoop, take: Callable[[Say], None]) -> None:
        """Call `take` with the kind of each frame from now on; a parent that is gone counts as STOP."""
        self._socket.setblocking(False)
        loop.add_reader(self._socket.fileno(), self._read, loop, take)
        loop.call_soon(self._take_all, take)  # what came together with the first frame

    def say(self, kind: Say, content: Any) -> None:
        """Send a frame; leave it out if the parent is behind."""
        with suppress(OSError):  # behind, or gone
            self._rest = self._rest[self._socket.send(self._rest) :] if self._rest else b""
            if not self._rest:
                self._rest = pack_frame(kind, json.dumps(content).encode())
                self._rest = self._rest[self._socket.send(self._rest) :]

    def finish(self, kind: Say, content: Any) -> None:
        """Send the last frame, and wait until the parent takes it."""
        self._socket.setblocking(True)
        with suppress(OSError):  # it is gone
            self._socket.sendall(self._rest + pack_frame(kind, json.dumps(content).encode()))
        self._socket.close()

    def _frame(self) -> tuple[Say, Any] | None:
        if len(self._arrived) < HEADER.size:
            return None
        kind, length = HEADER.unpack_from(self._arrived)
        end = HEADER.size + length
        if len(self._arrived) < end:
            return None
        body = bytes(self._arrived[HEADER.size : end])
        del self._arrived[:end]
        return Say(kind), json.loads(body)

    def _read(self, loop: asyncio.AbstractEventLoop, take: Callable[[Say], None]) -> None:
        try:
            data = self._socket.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            loop.remove_reader(self._socket.fileno())
            take(Say.STOP)
            return
        self._arrived += data
        self._take_all(take)

    def _take_all(self, take: Callable[[Say], None]) -> None:
        while (frame := self._frame()) is not None:
            take(frame[0])


def say_to(writer: asyncio.StreamWriter, kind: Say, content: Mapping[str, Any] | None = None) -> None:
    """Send a frame to a worker."""
    if not writer.is_closing():
        writer.write(pack_frame(kind, json.dumps(content).encode()))


async def hear(reader: asyncio.StreamReader) -> tuple[Say, Any] | None:
    """Return the next frame of a worker; None when it is gone."""
    try:
        kind, length = HEADER.unpack(await reader.readexactly(HEADER.size))
        return Say(kind), json.loads(await reader.readexactly(length))
    except (asyncio.IncompleteReadError, OSError):
        return None
