"""What ``--page`` adds to a master: a server, its address, and the page as a watcher."""

import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hapticnet.cli.options import AUTO
from hapticnet.errors import UnavailableError

if TYPE_CHECKING:
    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.settings import ChannelSettings
    from hapticnet.cli.console import Console
    from hapticnet.node.master import MasterNode
    from hapticnet.node.master_events import NodeEvent
    from hapticnet.operator.base import Operator
    from hapticnet.runtime.watching import Watcher
    from hapticnet.web.access import Access
    from hapticnet.web.messages import View

PAGE: str = "live page: "
"""Start of the message with the page's address."""


class ServedPage:
    """The socket on which pages will be served, opened early so that a wrong address is told at once.

    Parameters
    ----------
    access
        How to reach it.
    """

    def __init__(self, sock: socket.socket, access: "Access", console: "Console") -> None:
        self._sock = sock
        self._access = access
        self._console = console

    def close(self) -> None:
        """Give the address up; needed only if `watchers` are not run."""
        self._sock.close()

    def watchers(
        self,
        node: "MasterNode",
        hand: "Operator",
        source: str,
        device: str,
        slave: str,
        channels: Mapping[str, "ChannelSettings"],
        emulators: "Mapping[str, Emulator[Any] | None]",
    ) -> "list[Watcher[NodeEvent]]":
        """Return what serves the page of a master, in the order in which it is to be started."""
        from hapticnet.cli.master_messages import in_words
        from hapticnet.operator.live import LiveHand
        from hapticnet.web.controls import Controls
        from hapticnet.web.page import Page, PageSettings
        from hapticnet.web.server import Server

        ways = [
            (emulator, channels[way])
            for way in ("channel_in", "channel_out")
            if (emulator := emulators[way]) is not None
        ]
        settings = PageSettings(
            source=source.partition(":")[0],
            device=None if device == "none" else device,
            hand=hand if isinstance(hand, LiveHand) else None,
            operator_url=self._access.url("operator"),
            in_words=lambda event: in_words(event, node, slave),
            say=self._console.warn,
        )
        page = Page(node, Controls(node, ways), settings)
        return [Server(page, self._access, self._sock), page]


def choose_operator(operator: str | None, page: str | None, console: "Console") -> tuple[str, ServedPage | None]:
    """Return where the positions come from, and what serves the page, if there is one.

    Raises
    ------
    UnavailableError
        If the extra is not installed or the address cannot be used.
    SettingsError
        If the address is malformed.
    """
    if page is None and operator != "page":
        return operator or "scripted", None
    sock, access = listen_for(page, ("operator", "watch"), console)
    console.say(f"{PAGE}{access.url('watch')}", needed=True)
    console.say(f"operator view, the scene only: {access.url('operator')}", needed=True)
    return operator or "page", ServedPage(sock, access, console)


def listen_for(page: str | None, views: "tuple[View, ...]", console: "Console") -> "tuple[socket.socket, Access]":
    """Return the socket on which views will be served, and how to reach them.

    Raises
    ------
    UnavailableError
        If the extra is not installed or the address cannot be used.
    SettingsError
        If the address is malformed.
    """
    try:
        from hapticnet.web.access import listen_for_pages
        from hapticnet.web.server import Server  # noqa: F401 - needs aiohttp
    except ModuleNotFoundError as error:
        raise UnavailableError("the live page needs aiohttp: pip install 'hapticnet[web]'") from error
    from hapticnet.runtime.udp import is_loopback, parse_host_port

    sock, access = listen_for_pages(None if page in (None, AUTO) else parse_host_port(page, lowest_port=0), views)
    if not is_loopback(sock.getsockname()):
        console.say(
            "warning: other hosts can reach the page, and it is not encrypted: whoever reads these addresses on"
            " the network can move the needle"
        )
    return sock, access
