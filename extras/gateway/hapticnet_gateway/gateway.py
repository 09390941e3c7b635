"""A gateway: carries datagrams between browser tabs and one slave, without being able to read sealed ones.

``POST /offer`` with ``Authorization: Bearer TOKEN`` and an offer in SDP returns the answer in SDP, with status 201.
Each tab then has its own UDP socket to the slave, so the slave sees one address per tab.
"""

import asyncio
import logging
import socket
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any, Final

from aiohttp import web

from hapticnet.errors import PeerError, SettingsError, in_words
from hapticnet.protocol.buckets import TokenBucket
from hapticnet.runtime.system import now_us
from hapticnet.runtime.udp import HostPort, host_of, open_toward
from hapticnet.web.access import Access
from hapticnet.web.messages import View
from hapticnet.web.server import HEADERS, Site, static_files
from hapticnet_gateway.offer import LARGEST_OFFER, read_offer
from hapticnet_gateway.tab import Tab

DEFAULT: Final = HostPort("127.0.0.1", 47890)
PAGE: Final = "index.html"
MOST_TABS_PER_HOST: Final = 4  # a page that connects again may not have ended its old connection yet
OFFERS_PER_MIN: Final = 120
OFFERS_PER_MIN_PER_HOST: Final = 30
OFFERS_AT_ONCE: Final = 10
MOST_HOSTS: Final = 1000  # hosts whose rates of offers are remembered
DATAGRAMS_PER_S: Final = 8000  # of all tabs together, to the slave
OFFER_WITHIN_S: Final = 10.0  # longest time [s] for an offer to arrive, and to make its answer
CHECK_S: Final = 0.5
MOST_FAULTS: Final = 10  # kinds of faults that are printed, each once

_WASM: Final = HEADERS["Content-Security-Policy"].replace(
    "script-src 'self'", "script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'"
)
_HEADERS: Final = {
    **HEADERS,
    "Content-Security-Policy": _WASM,
}
NO_PAGE: Final = """This gateway carries datagrams, but was installed without its page.
In a checkout, 'make tab' builds it. Or use the page of the npm package, served elsewhere: --origin.
"""


@dataclass(frozen=True, slots=True)
class TabAccess(Access):
    """The address of a gateway, with its token in the fragment, which browsers never send."""

    def url(self, view: View) -> str:
        """Return the address of the page."""
        return f"http://{HostPort(self.host, self.port)}/#token={self.tokens[view]}"


class Gateway(Site):
    """Serve tabs at `access`, and carry their datagrams to `slave`.

    Parameters
    ----------
    slave
        The only address to which datagrams go, in numbers.
    origins
        Origins of pages served elsewhere, such as ``https://touch.example``, that may connect too.
    most_tabs
        Tabs at once.
    say, warn
        Called with lines for a person.
    """

    def __init__(
        self, slave: HostPort, access: Access, sock: socket.socket, origins: frozenset[str], most_tabs: int,
        say: Callable[[str], None], warn: Callable[[str], None],
    ) -> None:  # fmt: skip
        files = static_files(("hapticnet_gateway",))  # 'make tab' puts them there
        super().__init__(access, sock, files, headers=_HEADERS, most_bytes=LARGEST_OFFER)
        self.tabs: list[Tab] = []
        self.carried: Counter[str] = Counter()  # datagrams and bytes, by the direction
        self.refused: Counter[str] = Counter()  # offers, by the reason
        self.dropped: Counter[str] = Counter()  # datagrams and packets, by the reason
        self.faults: list[str] = []
        self._slave, self._origins, self._most_tabs = slave, origins, most_tabs
        self._say, self._warn = say, warn
        self._count = 0
        self._offers = TokenBucket(OFFERS_PER_MIN / 60, OFFERS_PER_MIN / 4)
        self._offers_of: dict[str, TokenBucket] = {}
        self._datagrams = TokenBucket(DATAGRAMS_PER_S, DATAGRAMS_PER_S / 4)
        self._leaving: set[asyncio.Task[None]] = set()

    @property
    def has_page(self) -> bool:
        """Whether the page was built."""
        return PAGE in self._files

    async def start(self) -> None:
        """Begin to serve."""
        for name in ("aiortc", "aioice"):
            logger = logging.getLogger(name)
            logger.propagate = False
            logger.addHandler(logging.NullHandler())  # otherwise a packet of a stranger could print a traceback
        asyncio.get_running_loop().set_exception_handler(self._note_fault)
        await super().start()

    async def run(self, stop: asyncio.Event, status: Callable[[str], None]) -> None:
        """Serve until `stop` is set; `status` gets a line now and then."""
        await self.start()
        try:
            while not stop.is_set():
                for tab in tuple(self.tabs):
                    tab.check()
                status(f"{len(self.tabs)} tabs, {self.carried['to_slave']} datagrams to the slave")
                try:
                    await asyncio.wait_for(stop.wait(), CHECK_S)
                except TimeoutError:
                    continue
        finally:
            for tab in tuple(self.tabs):
                tab.end("the gateway was stopped")
            await asyncio.gather(*self._leaving)
            await self.stop()

    def report(self) -> dict[str, Any]:
        """Return what was carried and what was not."""
        return {
            "slave": str(self._slave), "tabs": self._count, "carried": dict(self.carried),
            "refused": dict(self.refused), "dropped": dict(self.dropped), "faults": self.faults,
        }  # fmt: skip

    def _add_routes(self, router: web.UrlDispatcher) -> None:
        router.add_get("/", self._serve_page)
        router.add_get("/{name}", self._serve_file)
        router.add_post("/offer", self._serve_offer)
        router.add_options("/offer", self._serve_preflight)

    async def _serve_page(self, _: web.Request) -> web.Response:
        return self._file(PAGE) if self.has_page else web.Response(status=404, text=NO_PAGE)

    async def _serve_preflight(self, request: web.Request) -> web.Response:
        """Say to a browser whether a page of another origin may send an offer."""
        origin = self._origin(request)
        if origin is None:
            return self._refuse("wrong origin", 403, "This page may not connect here.")
        allowed = {
            "Access-Control-Allow-Methods": "POST",
            "Access-Control-Allow-Headers": "authorization, content-type",
        }
        return web.Response(status=204, headers={**_shared(origin), **allowed})

    async def _serve_offer(self, request: web.Request) -> web.Response:
        response = await self._answer_offer(request)
        response.force_close()  # one that has shown a token gives way to no other connection, so it must not stay
        return response

    async def _answer_offer(self, request: web.Request) -> web.Response:
        origin = self._origin(request)
        if origin is None:
            return self._refuse("wrong origin", 403, "This page may not connect here.")
        kind, _, token = request.headers.get("Authorization", "").partition(" ")
        if kind.lower() != "bearer" or not self._access.opens("operator", token.strip()):
            return self._refuse("wrong token", 401, "The token is missing or wrong.", origin)
        assert request.transport is not None  # noqa: S101 - for the type checker: the request was just read
        peer, here = (request.transport.get_extra_info(name) for name in ("peername", "sockname"))
        host = host_of(peer)
        if not self._may_offer(host):
            return self._refuse("too many offers", 429, "Too many connections were made; wait a minute.", origin)
        if self._gate is not None:
            self._gate.trust(request.transport)
        try:
            offer = read_offer(await asyncio.wait_for(request.read(), OFFER_WITHIN_S))
        except TimeoutError:
            return self._refuse("no valid offer", 408, f"The offer did not arrive within {OFFER_WITHIN_S:g} s.", origin)
        except (PeerError, web.HTTPRequestEntityTooLarge) as error:
            text = str(error) if isinstance(error, PeerError) else f"the offer has more than {LARGEST_OFFER} bytes"
            return self._refuse("no valid offer", 400, text, origin)
        if len(self.tabs) >= self._most_tabs or sum(tab.host == host for tab in self.tabs) >= MOST_TABS_PER_HOST:
            return self._refuse("too many tabs", 503, "Too many tabs are connected; close one.", origin)
        self._count += 1
        tab = Tab(self._count, host, here[0], self._slave, self.carried, self.dropped, self._datagrams.take, self._left)
        self.tabs.append(tab)
        try:
            answer = await asyncio.wait_for(tab.answer(offer), OFFER_WITHIN_S)
        except Exception as error:  # aiortc's, of an offer that it does not accept, or the system's
            tab.end(f"got no answer: {in_words(error)}")
            return self._refuse("no answer", 500, "The gateway could not answer.", origin)
        self._say(f"tab {tab.number} from {host} connects")
        return web.Response(status=201, text=answer, content_type="application/sdp", headers=_shared(origin))

    def _origin(self, request: web.Request) -> str | None:
        """Return the origin of the page that sends a request; None if it may not."""
        origin = request.headers.get("Origin", "")
        host = request.headers["Host"]
        return origin if origin in {f"http://{host}", f"https://{host}"} | self._origins else None

    def _may_offer(self, host: str) -> bool:
        now = now_us()
        if host not in self._offers_of:
            while len(self._offers_of) >= MOST_HOSTS:
                del self._offers_of[next(iter(self._offers_of))]
            self._offers_of[host] = TokenBucket(OFFERS_PER_MIN_PER_HOST / 60, OFFERS_AT_ONCE)
        return self._offers_of[host].take(now) and self._offers.take(now)

    def _refuse(self, why: str, status: int, text: str, origin: str | None = None) -> web.Response:
        self.refused[why] += 1
        return web.Response(status=status, text=f"{text}\n", headers=_shared(origin) if origin else None)

    def _left(self, tab: Tab, reason: str) -> None:
        self.tabs.remove(tab)
        leaving = asyncio.ensure_future(tab.closed())
        self._leaving.add(leaving)
        leaving.add_done_callback(self._leaving.discard)
        self._say(
            f"tab {tab.number} from {tab.host} left: {reason}"
            f" ({tab.to_slave} datagrams to the slave, {tab.to_tab} back)"
        )

    def _note_fault(self, _: asyncio.AbstractEventLoop, context: Mapping[str, Any]) -> None:
        """Report what a library of the connection raised, in place of a traceback."""
        error = context.get("exception")
        text = str(context.get("message")) if error is None else in_words(error)
        if text not in self.faults and len(self.faults) < MOST_FAULTS and not isinstance(error, ConnectionError):
            self.faults.append(text)
            self._warn(f"a fault that ends at most one tab: {text}")


def check_origin(text: str) -> str:
    """Return an origin as browsers send it; raise SettingsError if it is invalid."""
    scheme, separator, rest = text.lower().partition("://")
    if scheme not in ("http", "https") or not separator or not rest or any(each in rest for each in "/?#@ *"):
        raise SettingsError(f"origin {text!r} must be as browsers send it, such as https://touch.example")
    default = {"http": ":80", "https": ":443"}[scheme]  # browsers leave it out
    return text.lower().removesuffix(default)


def check_slave(address: HostPort) -> HostPort:
    """Return the slave's address in numbers, looked up once.

    Raises
    ------
    UnavailableError
        If there is no such host.
    SettingsError
        If it is not one host, but a group or all hosts of a network.
    """
    sock, target = open_toward(address)
    sock.close()
    host = ip_address(target[0].partition("%")[0])
    if host.is_multicast or host == ip_address("255.255.255.255"):
        raise SettingsError(f"slave is {address}; it must be the address of one host")
    return HostPort(target[0], target[1])


def _shared(origin: str) -> dict[str, str]:
    """Return the headers that let a page of an origin read the answer."""
    return {"Access-Control-Allow-Origin": origin, "Vary": "Origin"}
