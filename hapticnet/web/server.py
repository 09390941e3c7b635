"""The HTTP server of the page, on the master's event loop: files, tokens, checks of Host and Origin, sockets.

Files are read at the start: threads that read them from disk would contend with the tick for the interpreter.
"""

import asyncio
import logging
import mimetypes
import socket
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Iterable, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final
from urllib.parse import urlsplit

from aiohttp import WSMsgType, web

from hapticnet.node.events import NodeEvent
from hapticnet.runtime.watching import Watcher
from hapticnet.web.access import Access
from hapticnet.web.audience import Audience
from hapticnet.web.client import PARTING_S, Client
from hapticnet.web.gate import Gate
from hapticnet.web.messages import LARGEST_MESSAGE, VIEWS, CloseCode, View

HEARTBEAT_S: Final = 5.0  # time [s] between two pings, which detect pages that have gone silently

HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; font-src 'self';"
        " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Server": "hapticnet",
}

NO_ENTRY: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>hapticnet</title>
<link rel="stylesheet" href="static/theme.css"><link rel="stylesheet" href="static/page.css"></head>
<body class="operator"><main><section class="card told"><h2>This link does not open the page</h2>
<p>{why} If somebody gave you this link, please tell them.</p></section></main></body></html>
"""

INCOMPLETE: Final = """The address was opened without its token. Open the whole address that the program printed, or the
file:// address in its log."""
OF_ANOTHER_RUN: Final = """It belongs to an earlier run, or was not copied whole. Open the address that the program
printed last."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def static_files(packages: Iterable[str]) -> dict[str, tuple[bytes, str]]:
    """Return contents and media type of every file in the folders ``static`` of packages, by path."""
    found: dict[str, tuple[bytes, str]] = {}

    def walk(folder: Traversable, path: str) -> None:
        for entry in folder.iterdir():
            if entry.is_dir():
                walk(entry, f"{path}{entry.name}/")
            else:
                kind = (
                    "text/javascript" if entry.name.endswith((".js", ".mjs")) else mimetypes.guess_type(entry.name)[0]
                )
                found[path + entry.name] = entry.read_bytes(), kind or "text/plain"

    for package in packages:
        folder = files(package) / "static"
        if folder.is_dir():
            walk(folder, "")
    return found


class Site:
    """An HTTP server on an event loop: its files, and what it refuses.

    `files` has contents and media type by path; `headers` are sent with each answer, and `most_bytes` is the largest
    body of a request.
    """

    def __init__(
        self,
        access: Access,
        sock: socket.socket,
        files: dict[str, tuple[bytes, str]],
        *,
        headers: Mapping[str, str] = HEADERS,
        most_bytes: int = 1024,
    ) -> None:
        self._access = access
        self._sock = sock
        self._files = files
        self._headers = headers
        self._most_bytes = most_bytes
        self._runner: web.AppRunner | None = None
        self._gate: Gate | None = None
        self._listener: asyncio.Server | None = None

    async def start(self) -> None:
        """Begin to serve."""
        app = web.Application(middlewares=[self._guard], client_max_size=self._most_bytes)
        app.on_response_prepare.append(self._add_headers)
        app.router.add_get("/static/{name:.+}", self._serve_file)
        self._add_routes(app.router)
        logger = logging.getLogger("hapticnet.web")
        logger.disabled = True  # do not log unknown peers' requests, and never show a user a traceback
        runner = web.AppRunner(
            app, access_log=None, logger=logger, handle_signals=False, shutdown_timeout=1.0, lingering_time=1.0
        )
        await runner.setup()
        self._runner = runner
        assert runner.server is not None  # noqa: S101 - for the type checker: set up above
        self._gate = Gate(runner.server)
        self._listener = await asyncio.get_running_loop().create_server(self._gate, sock=self._sock)

    async def stop(self) -> None:
        """End every connection."""
        if self._listener is not None:
            self._listener.close()
        if self._runner is not None:
            await self._runner.cleanup()
        if self._gate is not None:
            self._gate.close()

    def _add_routes(self, router: web.UrlDispatcher) -> None:
        """Add what it serves besides files."""

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse requests that a foreign page may have caused."""
        await asyncio.sleep(0)  # requests that arrive in one piece are answered one by one, with ticks between them
        if not self._access.is_ours(request.headers.get("Host", "")):
            raise web.HTTPMisdirectedRequest(text="This server has another name. Open the address that was printed.\n")
        return await handler(request)

    async def _serve_file(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in self._files or name.endswith(".html"):
            return web.Response(status=404, text="There is no such file.\n")
        return self._file(name)

    def _file(self, name: str) -> web.Response:
        body, kind = self._files[name]
        charset = "utf-8" if kind.startswith("text/") or kind.endswith("javascript") else None
        return web.Response(body=body, content_type=kind, charset=charset)

    async def _add_headers(self, _: web.Request, response: web.StreamResponse) -> None:
        response.headers.update(self._headers)


class ViewSite(Site, ABC):
    """A site of views, each with a token and a socket."""

    views: tuple[View, ...] = VIEWS  # the served views

    def _add_routes(self, router: web.UrlDispatcher) -> None:
        views = "|".join(self.views)
        router.add_get(f"/{{view:{views}}}", self._serve_view)
        router.add_get(f"/socket/{{view:{views}}}", self._serve_socket)

    async def _serve_view(self, request: web.Request) -> web.Response:
        view = _view(request)
        token = request.query.get("token", "")
        if not self._access.opens(view, token):
            text = NO_ENTRY.format(why=OF_ANOTHER_RUN if token else INCOMPLETE)
            return web.Response(status=403, text=text, content_type="text/html", charset="utf-8")
        return self._file(self._document(view, request))

    @abstractmethod
    def _document(self, view: View, request: web.Request) -> str:
        """Return the file of a view."""

    async def _serve_socket(self, request: web.Request) -> web.StreamResponse:
        view = _view(request)
        try:
            origin = urlsplit(request.headers.get("Origin", "")).netloc
        except ValueError:
            origin = ""
        if origin != request.headers["Host"]:
            return web.Response(status=403, text="This page may not connect here.\n")
        ws = web.WebSocketResponse(
            timeout=PARTING_S, autoping=False, heartbeat=HEARTBEAT_S, compress=False, max_msg_size=LARGEST_MESSAGE
        )
        await ws.prepare(request)
        if not self._access.opens(view, request.query.get("token", "")):
            await ws.close(code=CloseCode.WRONG_TOKEN, message=b"this link is not valid, or of an earlier run")
            return ws
        if request.transport is not None and self._gate is not None:
            self._gate.trust(request.transport)
            await self._converse(view, request, ws)
        return ws

    @abstractmethod
    async def _converse(self, view: View, request: web.Request, ws: web.WebSocketResponse) -> None:
        """Exchange messages with a page that has shown its token, until its end."""


class Server(ViewSite, Watcher[NodeEvent]):
    """Serves pages while the master runs."""

    name = "page"

    def __init__(self, page: Audience, access: Access, sock: socket.socket) -> None:
        super().__init__(access, sock, static_files(page.packages))
        self._page = page
        self.views = page.views

    def _document(self, view: View, request: web.Request) -> str:  # noqa: ARG002
        return self._page.documents[view]

    async def _converse(self, view: View, request: web.Request, ws: web.WebSocketResponse) -> None:
        if (refusal := self._page.refusal()) is not None:
            code, reason = refusal
            await ws.close(code=code, message=reason.encode())
        elif request.transport is not None:
            await self._talk(Client(view, ws, request.transport), ws)

    async def _talk(self, client: Client, ws: web.WebSocketResponse) -> None:
        self._page.connect(client)
        try:
            async for message in ws:
                if not client.admits():
                    client.close(CloseCode.TOO_MANY_MESSAGES, "too many messages")
                elif message.type is WSMsgType.PING:
                    await ws.pong(message.data)
                elif message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                    self._page.receive(client, message.data)
                elif message.type is not WSMsgType.PONG:
                    break
                if client.is_closing:
                    break
        finally:
            self._page.disconnect(client)
            await client.finish()


def _view(request: web.Request) -> View:
    return "watch" if request.match_info["view"] == "watch" else "operator"
