"""Parts that ``--page`` adds to a master: a server, its address, and the page as a watcher."""

import atexit
import os
import re
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote, urlsplit

from hapticnet.errors import UnavailableError
from hapticnet.options import AUTO

if TYPE_CHECKING:
    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.settings import ChannelSettings
    from hapticnet.cli.console import Console
    from hapticnet.node.events import NodeEvent
    from hapticnet.node.master import MasterNode
    from hapticnet.operator.base import Operator
    from hapticnet.runtime.udp import HostPort
    from hapticnet.runtime.watching import Watcher
    from hapticnet.web.access import Access
    from hapticnet.web.audience import Audience
    from hapticnet.web.messages import View
    from hapticnet.web.server import Site

PAGE: Final = "live page: "  # start of the message with the page's address
_FILE: Final = re.compile(r"open (file://\S+\.html) in a browser; it holds the token for \S+")
_LINK: Final = '<!doctype html><meta http-equiv="refresh" content="0; url={url}"><a href="{url}">hapticnet</a>\n'


async def until_signal(site: "Site", *audience: "Audience") -> None:
    """Serve a site until SIGINT or SIGTERM; its audience is told before it ends."""
    import asyncio

    from hapticnet.runtime.signals import stop_on_signals

    await site.start()
    try:
        await stop_on_signals(asyncio.get_running_loop()).wait()
    finally:
        for pages in audience:
            await pages.stop()
        await site.stop()


class ServedPage:
    """The socket on which pages will be served, opened early so that a wrong address is reported at once."""

    def __init__(self, sock: socket.socket, access: "Access", console: "Console") -> None:
        self._sock = sock
        self._access = access
        self._console = console

    def close(self) -> None:
        """Release the address; needed only if `watchers` are not run."""
        self._sock.close()

    def watchers(
        self,
        node: "MasterNode",
        hand: "Operator",
        source: str,
        device: str,
        channels: Mapping[str, "ChannelSettings"],
        emulators: "Mapping[str, Emulator[Any] | None]",
        in_words: "Callable[[NodeEvent], str]",
    ) -> "list[Watcher[NodeEvent]]":
        """Return the servers of a master's page, in their order of starting."""
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
            yields=hasattr(hand, "feel"),
            operator_url=self._access.url("operator"),
            in_words=in_words,
            say=self._console.warn,
        )
        page = Page(node, Controls(node, ways), settings)
        return [Server(page, self._access, self._sock), page]


def choose_operator(operator: str | None, page: str | None, console: "Console") -> tuple[str, ServedPage | None]:
    """Return the source of positions and the server of the page, if any; raise like `listen_for`."""
    if page is None and (operator or "").partition(":")[0] != "page":
        return operator or "scripted", None
    sock, access = listen_for(page, ("operator", "watch"), console)
    say_addresses({PAGE: "watch", "operator view, the scene only: ": "operator"}, access, console)
    return operator or "page", ServedPage(sock, access, console)


def listen_for(
    page: str | None, views: "tuple[View, ...]", console: "Console", can: str = "move the needle"
) -> "tuple[socket.socket, Access]":
    """Return the socket on which views will be served, and how to reach them; `can`: what their addresses allow.

    Raise UnavailableError if the extra is missing or the address cannot be used; SettingsError if it is malformed.
    """
    try:
        from hapticnet.web.access import listen_for_pages
        from hapticnet.web.server import Server  # noqa: F401 - needs aiohttp
    except ModuleNotFoundError as error:
        raise UnavailableError("the live page needs aiohttp (extra web): pip install aiohttp") from error
    from hapticnet.runtime.udp import is_loopback

    sock, access = listen_for_pages(page_address(page), views)
    if not is_loopback(sock.getsockname()):
        console.warn(
            "other hosts can reach the page, and it is not encrypted: anyone who reads these addresses on"
            f" the network can {can}"
        )
    return sock, access


def page_address(page: str | None) -> "HostPort | None":
    """Return the address of ``--page``; None without one. Raise SettingsError if it is malformed."""
    from hapticnet.runtime.udp import parse_host_port

    return None if page in (None, AUTO) else parse_host_port(page, lowest_port=0)


def say_addresses(views: "Mapping[str, View]", access: "Access", console: "Console") -> None:
    """Print the addresses of views, each with its text before it; raise UnavailableError if a file cannot be written.

    The tokens in them are for a person at a terminal. Other outputs may be logs that others read: they get the
    names of files in a folder of this user, each of which redirects a browser to a view.
    """
    addresses = {text: access.url(view) for text, view in views.items()}
    if not _on_terminal():
        try:
            place = os.environ.get("XDG_RUNTIME_DIR", "")
            folder = Path(tempfile.mkdtemp(prefix="hapticnet-page-", dir=place if os.access(place, os.W_OK) else None))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            for text, view in views.items():
                file = folder / f"{view}.html"
                file.write_text(_LINK.format(url=addresses[text]), encoding="utf-8")
                addresses[text] = (
                    f"open {file.as_uri()} in a browser; it holds the token for {re.split('[?#]', addresses[text])[0]}"
                )
        except OSError as error:
            raise UnavailableError(f"cannot store the page's address: {error.strerror}: {error.filename}") from error
    for text, address in addresses.items():
        console.say(f"{text}{address}", needed=True)


def address_in(line: str) -> tuple[str, str]:
    """Return the file that a line of `say_addresses` names, as an address, and the line for this process's reader."""
    found = _FILE.search(line)
    if found is None:
        return "", line
    if _on_terminal():
        line = line.replace(found[0], address_of(found[1]))
    return found[1], line


def address_of(file: str) -> str:
    """Return the address to which a file of `say_addresses` leads."""
    link = Path(unquote(urlsplit(file).path)).read_text(encoding="utf-8")
    return link.partition('href="')[2].partition('"')[0]


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()
