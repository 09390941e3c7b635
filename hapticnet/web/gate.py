"""Throttle the connections to the page, so that no flood delays a tick.

Thousands of frames that arrive together would be parsed in one call. The gate passes bytes on in portions, at most one
every `PASS_S`, and reads nothing more from a connection meanwhile. Those that have shown a token go first.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Final

PASS_S: Final = 0.001  # time [s] between two portions
PORTION_BYTES: Final = 256  # largest portion [B] passed on at once; a page with the hand sends 6 in a millisecond
BYTES_PER_S: Final = 32 * 1024
RESERVE_BYTES: Final = 128 * 1024  # limit [B] of all connections without a token together; loading a page takes 20 kB
MOST_CONNECTIONS: Final = 128  # with one more, the oldest without a token ends; a browser opens up to 7 for a page


class Gate:
    """Pass on the input of a server's connections; the server makes a protocol for each."""

    def __init__(self, make_protocol: Callable[[], asyncio.Protocol]) -> None:
        self._make_protocol = make_protocol
        self._loop = asyncio.get_running_loop()
        self._open: OrderedDict[Connection, None] = OrderedDict()  # without a token, oldest first
        self._trusted: set[Connection] = set()
        self._waiting: tuple[OrderedDict[Connection, None], ...] = (OrderedDict(), OrderedDict())  # with token; without
        self._reserve_bytes = float(RESERVE_BYTES)
        self._passed_s = self._loop.time()
        self._timer: asyncio.TimerHandle | None = None

    def __call__(self) -> "Connection":
        """Return the protocol of a new connection."""
        return Connection(self, self._make_protocol())

    def trust(self, transport: object) -> None:
        """Give a connection priority, because it has shown a token."""
        connection = transport.connection if isinstance(transport, GatedTransport) else None
        if connection is not None and connection in self._open:
            del self._open[connection]
            self._trusted.add(connection)

    def close(self) -> None:
        """End all connections."""
        if self._timer is not None:
            self._timer.cancel()
        for connection in (*self._open, *self._trusted):
            connection.abort()

    def enter(self, connection: "Connection") -> None:
        """Add a connection."""
        self._open[connection] = None
        if len(self._open) + len(self._trusted) > MOST_CONNECTIONS:
            next(iter(self._open)).abort()

    def leave(self, connection: "Connection") -> None:
        """Forget a connection."""
        self._open.pop(connection, None)
        self._trusted.discard(connection)
        for line in self._waiting:
            line.pop(connection, None)

    def queue(self, connection: "Connection") -> None:
        """Queue a connection whose bytes wait."""
        self._waiting[connection not in self._trusted][connection] = None
        self._start()

    def _start(self) -> None:
        if self._timer is None:
            self._timer = self._loop.call_later(max(0.0, self._passed_s + PASS_S - self._loop.time()), self._pass)

    def _pass(self) -> None:
        """Serve one connection of each queue."""
        now_s = self._loop.time()
        refill = max(0.0, now_s - self._passed_s) * BYTES_PER_S
        self._reserve_bytes = min(self._reserve_bytes + refill, float(RESERVE_BYTES))
        self._passed_s = now_s
        self._timer = None
        with_token, without = self._waiting
        if with_token:
            with_token.popitem(last=False)[0].take_turn(PORTION_BYTES)
        if without and self._reserve_bytes >= PORTION_BYTES:
            self._reserve_bytes -= without.popitem(last=False)[0].take_turn(PORTION_BYTES)
        if with_token or without:
            self._start()


class Connection(asyncio.Protocol):
    """A connection between socket and server."""

    def __init__(self, gate: Gate, server: asyncio.Protocol) -> None:
        self._gate = gate
        self._server = server
        self._bytes = bytearray()
        self._is_paused = False
        self._has_ended = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        self._transport: Any = transport
        self._gate.enter(self)
        self._server.connection_made(GatedTransport(self, transport))  # type: ignore[arg-type] # what aiohttp needs of it

    def connection_lost(self, error: Exception | None) -> None:
        """End; notify the server only after its tasks have begun, because aiohttp's fail on a lost connection."""
        self._gate.leave(self)
        self._bytes.clear()
        asyncio.get_running_loop().call_soon(self._server.connection_lost, error)

    def data_received(self, data: bytes) -> None:
        """Keep the received bytes until this connection's turn, and read nothing more until then."""
        self._bytes += data
        if not self._transport.is_closing():
            self._transport.pause_reading()
            self._queue()

    def eof_received(self) -> bool | None:
        """Note that nothing more will arrive."""
        self._has_ended = True
        if self._bytes:
            return True
        return self._server.eof_received()

    def abort(self) -> None:
        """End at once."""
        self._transport.abort()

    def pause_writing(self) -> None:
        """Pass on that the other end reads slowly."""
        self._server.pause_writing()

    def resume_writing(self) -> None:
        """Pass on that the other end reads again."""
        self._server.resume_writing()

    def take_turn(self, most_bytes: int) -> int:
        """Pass a portion on; return its size."""
        portion = bytes(self._bytes[:most_bytes])
        del self._bytes[:most_bytes]
        self._server.data_received(portion)
        if self._transport.is_closing():
            return len(portion)
        if self._bytes:
            self._queue()
        elif self._has_ended:
            if not self._server.eof_received():
                self._transport.close()
        elif not self._is_paused:
            self._transport.resume_reading()
        return len(portion)

    def pause_reading(self) -> None:
        """Pause, because the server is busy."""
        self._is_paused = True
        self._transport.pause_reading()

    def resume_reading(self) -> None:
        """Resume passing on input."""
        self._is_paused = False
        if self._bytes:
            self._queue()
        elif not self._transport.is_closing():
            self._transport.resume_reading()

    def _queue(self) -> None:
        if not self._is_paused:
            self._gate.queue(self)


class GatedTransport:
    """The transport that the server gets for a connection."""

    def __init__(self, connection: Connection, transport: asyncio.BaseTransport) -> None:
        self.connection = connection
        self.pause_reading = connection.pause_reading
        self.resume_reading = connection.resume_reading
        self._transport = transport

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)
