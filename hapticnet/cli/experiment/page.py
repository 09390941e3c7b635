"""``--page`` of the experiment: what serves the participant's page."""

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hapticnet.cli.console import Console
from hapticnet.cli.pages import listen_for, page_address, say_addresses
from hapticnet.errors import SettingsError
from hapticnet.files import make_folder
from hapticnet.operator.base import Operator
from hapticnet.study.plan import Plan

if TYPE_CHECKING:  # the page needs the extra web
    from hapticnet.node.events import NodeEvent
    from hapticnet.runtime.watching import Watcher
    from hapticnet.study.page import ParticipantPage
    from hapticnet.web.access import Access

PARTICIPANT: Final = "the participant's page: "  # start of the message with the page's address
ADDRESS_FILE: Final = ".page.json"  # port and token of the page, in the folder of a session that is not over
LEAST_TOKEN: Final = 16  # fewest characters of a token


@dataclass(frozen=True, slots=True)
class OpenedPage:
    """The socket on which the page will be served, opened early so that a wrong address is told at once."""

    sock: socket.socket
    access: "Access"
    console: Console

    def make(
        self, hand: Operator | None, source: str, plan: Plan
    ) -> "tuple[ParticipantPage, Operator | None, tuple[Watcher[NodeEvent], ...]]":
        """Return the page of a session, the hand that moves its needle, and what serves it.

        `source` says where the positions come from, in a word.
        """
        from hapticnet.study.page import ParticipantPage, SeenHand
        from hapticnet.web.server import Server

        seen, say = None if hand is None else SeenHand(hand), self.console.say
        page = ParticipantPage(seen, source, texts=plan.texts, masking_noise=plan.masking_noise, say=say)
        return page, seen, (Server(page, self.access, self.sock), page)


def check_page(page: str | None, simulate: str | None, operator: str | None) -> None:
    """Raise SettingsError if a page has no address or nobody to look at it, or is missing though it is the hand."""
    page_address(page)
    if page is not None and simulate is not None:
        raise SettingsError("--page is for a person; a simulated observer needs none")
    if page is None and operator == "page":
        raise SettingsError("--operator page needs --page")


@contextmanager
def open_page(page: str | None, console: Console, folder: Path, *, resume: bool) -> Iterator[OpenedPage | None]:
    """Yield the page that was asked for, if any, and print its address.

    A session that goes on has the address of the run before, so that a page which is still open finds it again: the
    folder of the session keeps it until the session is over.
    """
    if page is None:
        yield None
        return
    path = folder / ADDRESS_FILE
    sock, access = listen_for(page, ("operator",), console, _kept_address(path) if resume else None)
    with sock:
        if resume or not path.exists():  # a session that exists does not begin again
            _keep_address(access, path)
        say_addresses({PARTICIPANT: "operator"}, access, console)
        console.say("press Escape here to stop what the participant feels, Ctrl-C to interrupt the session")
        yield OpenedPage(sock, access, console)
        path.unlink(missing_ok=True)


def _keep_address(access: "Access", path: Path) -> None:
    """Store port and token of the page where only this account can read them."""
    make_folder(path.parent)
    with suppress(OSError):  # then a page that is still open must be given the new address
        path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600), "w") as file:
            json.dump({"port": access.port, "token": access.tokens["operator"]}, file)


def _kept_address(path: Path) -> "Access | None":
    """Return how the page was reached in the run before; None if that is not known or not secret."""
    from hapticnet.web.access import DEFAULT, Access

    try:
        with path.open() as file:
            status = os.fstat(file.fileno())
            kept = json.loads(file.read(10_000))
        if status.st_uid != os.geteuid() or status.st_mode & 0o077:
            return None
        port, token = kept["port"], kept["token"]
    except (OSError, ValueError, TypeError, KeyError):
        return None
    if not isinstance(port, int) or not 0 < port < 65536 or not isinstance(token, str) or len(token) < LEAST_TOKEN:
        return None
    return Access(DEFAULT.host, port, {"operator": token})
