"""``--page`` of the experiment: what serves the participant's page."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from hapticnet.cli.console import Console
from hapticnet.cli.pages import listen_for, page_address, say_addresses
from hapticnet.errors import SettingsError
from hapticnet.operator.base import Operator
from hapticnet.study.plan import Plan

if TYPE_CHECKING:  # the page needs the extra web
    from hapticnet.node.events import NodeEvent
    from hapticnet.runtime.watching import Watcher
    from hapticnet.study.page import ParticipantPage
    from hapticnet.web.access import Access

PARTICIPANT: Final = "the participant's page: "  # start of the message with the page's address


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
def open_page(page: str | None, console: Console) -> Iterator[OpenedPage | None]:
    """Yield the page that was asked for, if any, and print its address."""
    if page is None:
        yield None
        return
    sock, access = listen_for(page, ("operator",), console)
    with sock:
        say_addresses({PARTICIPANT: "operator"}, access, console)
        console.say("press Escape here to stop what the participant feels, Ctrl-C to interrupt the session")
        yield OpenedPage(sock, access, console)
