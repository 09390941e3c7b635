"""The address of the page, and access to it."""

import ipaddress
import secrets
import socket
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlsplit

from hapticnet.errors import UnavailableError
from hapticnet.runtime.udp import HostPort, listen_for_streams
from hapticnet.web.messages import VIEWS, View

DEFAULT: Final = HostPort("127.0.0.1", 47880)  # where the page is served unless another address is named


@dataclass(frozen=True, slots=True)
class Access:
    """The address of the page, and the tokens that open its views."""

    host: str  # this server's name in a browser
    port: int
    tokens: dict[View, str] = field(default_factory=lambda: new_tokens(VIEWS))
    names: frozenset[str] = frozenset()  # further names, such as that of a proxy

    def url(self, view: View) -> str:
        """Return the address of a view."""
        return f"http://{HostPort(self.host, self.port)}/{view}?token={self.tokens[view]}"

    def opens(self, view: View, token: str) -> bool:
        """Return whether a token opens a view."""
        return secrets.compare_digest(token.encode(errors="surrogateescape"), self.tokens[view].encode())

    def is_ours(self, host: str) -> bool:
        """Return whether a Host header names this server at any port, and not a foreign name (DNS rebinding)."""
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        if name in ("localhost", self.host.lower(), socket.gethostname().lower(), *self.names):
            return True
        try:
            ipaddress.ip_address(name or "")
        except ValueError:
            return False
        return True


def new_tokens(views: tuple[View, ...]) -> dict[View, str]:
    """Return a token for each view, drawn at random."""
    return {view: secrets.token_urlsafe(16) for view in views}


def listen_for_pages(address: HostPort | None, views: tuple[View, ...] = VIEWS) -> tuple[socket.socket, Access]:
    """Return a listening socket (port 0: a free one) and the access to `views`; UnavailableError if not possible.

    Without an `address`, `DEFAULT` is used, or another port of that host if this one is taken.
    """
    wanted = address or DEFAULT
    try:
        sock = listen_for_streams(wanted, f"cannot serve the page at {wanted}")
    except UnavailableError:
        if wanted == address:
            raise
        sock = listen_for_streams(HostPort(wanted.host, 0), f"cannot serve the page at {wanted.host}")
    host, port = sock.getsockname()[:2]
    named = address.host if address is not None else host
    host = socket.gethostname() if named in ("0.0.0.0", "::") else named  # noqa: S104
    return sock, Access(host, port, new_tokens(views))
