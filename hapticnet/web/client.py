"""One connected page: messages to it, without ever waiting for it, and messages from it."""

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Final

from aiohttp import web

from hapticnet.runtime.system import now_us
from hapticnet.web.messages import View

if TYPE_CHECKING:
    from hapticnet.web.messages import Hand

LARGEST_BACKLOG: Final = 1 << 18  # bytes waiting for a page above which messages are omitted; 40 kB last a second
LONGEST_QUEUE: Final = 256  # messages waiting for a page, above which it is disconnected
PARTING_S: Final = 0.5  # longest time [s] for a page to receive the reason for its disconnection
MOST_MESSAGES_PER_S: Final = 600  # messages a second from one page, above which it is disconnected; a hand sends 250


class Client:
    """A page, its WebSocket and the connection below."""

    def __init__(self, view: View, socket: web.WebSocketResponse, transport: asyncio.WriteTransport) -> None:
        self.view = view  # its permissions
        self.left_out = 0  # messages omitted because it reads too slowly
        self.mistakes = 0  # messages from it outside the specification
        self.heard: Hand | None = None  # its newest HAND message
        self._socket = socket
        self._transport = transport
        self._queue: deque[str | bytes] = deque()
        self._queued_bytes = 0
        self._wake = asyncio.Event()
        self._second = 0
        self._messages = 0
        self._closing: tuple[int, str] | None = None
        self._sender = asyncio.ensure_future(self._send())

    def post(self, message: str) -> None:
        """Send a JSON message as soon as the page reads."""
        if len(self._queue) >= LONGEST_QUEUE:
            self._transport.abort()  # it would not read a reason either; a page that wakes up connects again
            return
        self._put(message)

    def post_replaceable(self, message: str | bytes) -> None:
        """Send a message, or omit it if the page reads too slowly: a later one replaces it."""
        if self._queued_bytes + self._transport.get_write_buffer_size() > LARGEST_BACKLOG:
            self.left_out += 1
            return
        self._put(message)

    def admits(self) -> bool:
        """Count a message from the page; return whether its rate is allowed."""
        second = now_us() // 1_000_000
        if second != self._second:
            self._second, self._messages = second, 0
        self._messages += 1
        return self._messages <= MOST_MESSAGES_PER_S

    @property
    def is_closing(self) -> bool:
        """Whether the page is being disconnected."""
        return self._closing is not None

    def close(self, code: int, reason: str) -> None:
        """Disconnect the page with a reason."""
        if self._closing is None:
            self._closing = code, reason
            self._wake.set()

    async def finish(self) -> None:
        """Stop sending; if the page is being disconnected, first give it a moment to receive the reason."""
        if self._closing is not None:
            await asyncio.wait([self._sender], timeout=PARTING_S)
        self._sender.cancel()
        await asyncio.gather(self._sender, return_exceptions=True)

    def _put(self, message: str | bytes) -> None:
        self._queue.append(message)
        self._queued_bytes += len(message)
        self._wake.set()

    async def _send(self) -> None:
        """Send the queue. Only this task waits for the page."""
        socket = self._socket
        try:
            while self._closing is None:
                await self._wake.wait()
                self._wake.clear()
                while self._queue:  # also before a farewell: it may be the last word of an experiment
                    message = self._queue.popleft()
                    self._queued_bytes -= len(message)
                    await (socket.send_str(message) if isinstance(message, str) else socket.send_bytes(message))
            code, reason = self._closing
            await socket.close(code=code, message=reason.encode())
        except (ConnectionError, RuntimeError):  # the page has gone; its reader finds out
            pass
        finally:
            self._queue.clear()
