"""The gallery: an index of demonstrations, and the page of the one that runs.

``/watch`` is the index, ``/watch?show=2&variant=1`` the page of a demonstration. The socket of that page starts the
demonstration, unless it runs already, and carries messages between the page and the demonstration's own master, so that
visitors need only one address and token. One demonstration runs at a time, and ends `UNWATCHED_S` after its last page
has closed.
"""

import asyncio
import json
import socket
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Final, NamedTuple, Protocol
from urllib.parse import urlsplit

from aiohttp import ClientError, ClientSession, ClientWebSocketResponse, WSMsgType, web

from hapticnet.errors import HapticnetError, SettingsError
from hapticnet.web.access import Access
from hapticnet.web.messages import CloseCode, View
from hapticnet.web.server import ViewSite, static_files

CHECK_S: Final = 1.0  # time [s] between two looks whether a demonstration has ended by itself
UNWATCHED_S: Final = 20.0  # time [s] for which a demonstration runs on while no page watches it
REASON_BYTES: Final = 120  # of the reason for which a socket is closed; WebSocket allows 123
GOING_AWAY: Final = 1001

Socket = web.WebSocketResponse | ClientWebSocketResponse


class Demonstration(NamedTuple):
    """What to start: options of a slave and of a master, as on the command line."""

    slave: tuple[str, ...]
    master: tuple[str, ...]


class Running(Protocol):
    """A demonstration that runs. Both methods may be called from any thread."""

    url: str  # address of the watch view of its master, with the token

    def has_ended(self) -> bool:
        """Return whether a part of it has ended by itself."""
        ...

    def end(self) -> None:
        """End it."""
        ...


def demonstrations() -> dict[tuple[str, str], Demonstration]:
    """Return the demonstrations of ``static/gallery.json`` by number, from 1, and variant, from 0."""
    text = files("hapticnet.web").joinpath("static/gallery.json").read_text(encoding="utf-8")
    return {
        (str(number), str(place)): Demonstration((*each["slave"],), (*each["master"], *variant["master"]))
        for number, each in enumerate(json.loads(text), start=1)
        for place, variant in enumerate(each["variants"])
    }


class Gallery(ViewSite):
    """Serves the gallery.

    `start` starts a demonstration, in a thread, and raises a HapticnetError if it cannot. `say` is called with lines
    for the person at the terminal.
    """

    views = ("watch",)

    def __init__(
        self,
        access: Access,
        sock: socket.socket,
        start: Callable[[Demonstration], Running],
        say: Callable[[str], None],
        *,
        unwatched_s: float = UNWATCHED_S,
    ) -> None:
        super().__init__(access, sock, static_files(("hapticnet.web",)))
        self._known = demonstrations()
        self._launch = start
        self._say = say
        self._unwatched_s = unwatched_s
        self._watching = 0  # pages
        self._key = "", ""
        self._running: Running | None = None
        self._changing = asyncio.Lock()
        self._timer: asyncio.TimerHandle | None = None
        self._ending: asyncio.Task[None] | None = None

    async def stop(self) -> None:
        """End every connection and the demonstration."""
        self._keep()
        await super().stop()
        await self._end()

    def _document(self, view: View, request: web.Request) -> str:
        return f"{view}.html" if "show" in request.query else "gallery.html"

    async def _converse(self, view: View, request: web.Request, ws: web.WebSocketResponse) -> None:  # noqa: ARG002
        self._watching += 1
        self._keep()
        try:
            running = await self._join(request.query)
            code, reason = await _carry(ws, running)
            if code in (CloseCode.MASTER_ENDED, GOING_AWAY):
                is_other = running is not self._running
                reason = "another demonstration was started" if is_other else "the demonstration has ended"
                code = CloseCode.MASTER_ENDED
        except HapticnetError as error:
            self._say(f"demonstration {request.query.get('show', '')} cannot be started: {error}")
            code, reason = CloseCode.NOT_STARTED, f"the demonstration cannot be started: {error}"
        finally:
            self._watching -= 1
            if not self._watching:
                self._timer = asyncio.get_running_loop().call_later(self._unwatched_s, self._end_unwatched)
        await ws.close(code=code, message=reason.encode()[:REASON_BYTES].decode(errors="ignore").encode())

    async def _join(self, query: Mapping[str, str]) -> Running:
        """Return the wanted demonstration, after starting it if it does not run."""
        key = query.get("show", ""), query.get("variant", "0")
        if key not in self._known:
            raise SettingsError(f"there is no demonstration {key[0][:10]!r} with variant {key[1][:10]!r}")
        async with self._changing:
            if self._running is None or self._key != key or await asyncio.to_thread(self._running.has_ended):
                await self._end()
                self._key = key
                self._running = await asyncio.to_thread(self._launch, self._known[key])
            return self._running

    async def _end(self) -> None:
        running, self._running = self._running, None
        if running is not None:
            await asyncio.to_thread(running.end)

    def _keep(self) -> None:
        """Cancel the planned end of the demonstration."""
        if self._timer is not None:
            self._timer.cancel()

    def _end_unwatched(self) -> None:
        async def end() -> None:
            async with self._changing:
                if not self._watching:
                    await self._end()

        self._ending = asyncio.ensure_future(end())


async def _carry(page: web.WebSocketResponse, running: Running) -> tuple[int, str]:
    """Carry messages between a page and a demonstration, until one ends; return the master's code and reason."""
    address = urlsplit(running.url)
    origin = f"{address.scheme}://{address.netloc}"
    try:
        async with (
            ClientSession() as session,
            session.ws_connect(f"{origin}/socket{address.path}?{address.query}", origin=origin) as master,
        ):
            ways = [asyncio.ensure_future(_pass_on(*way)) for way in ((master, page), (page, master))]
            try:
                done: set[asyncio.Future[tuple[int, str]]] = set()
                while not done and not await asyncio.to_thread(running.has_ended):
                    done, _ = await asyncio.wait(ways, timeout=CHECK_S, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                ends = await asyncio.gather(*ways, return_exceptions=True)
            return ends[0] if isinstance(ends[0], tuple) else (GOING_AWAY, "")
    except (ClientError, OSError):  # it has just ended
        return GOING_AWAY, ""


async def _pass_on(source: Socket, target: Socket) -> tuple[int, str]:
    """Pass the messages of one socket on to another; return code and reason of its end."""
    while True:
        message = await source.receive()
        if message.type is WSMsgType.TEXT:
            await target.send_str(message.data)
        elif message.type is WSMsgType.BINARY:
            await target.send_bytes(message.data)
        elif message.type is WSMsgType.PING:
            await source.pong(message.data)
        elif message.type is WSMsgType.CLOSE:
            return message.data or GOING_AWAY, message.extra or ""
        elif message.type is not WSMsgType.PONG:
            return GOING_AWAY, ""
