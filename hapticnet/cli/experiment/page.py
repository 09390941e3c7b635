"""``--page`` of the experiment: what serves the participant's page."""

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

if TYPE_CHECKING:
    from hapticnet.cli.console import Console
    from hapticnet.node.master_events import NodeEvent
    from hapticnet.operator.base import Operator
    from hapticnet.runtime.watching import Watcher
    from hapticnet.study.page import ParticipantPage
    from hapticnet.study.page_front import PageFront
    from hapticnet.web.access import Access

PageOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--page",
        metavar="[HOST:PORT]",
        help="Let the participant see and answer everything on a page in the browser, by default on 127.0.0.1:47880 or"
        " a free port, and print its URL; needs hapticnet[web].",
    ),
]

PARTICIPANT: Final = "the participant's page: "
"""Start of the message with the page's address."""


@dataclass(frozen=True, slots=True)
class OpenedPage:
    """The socket on which the page will be served, opened early so that a wrong address is told at once."""

    sock: socket.socket
    access: "Access"
    say: Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Screen:
    """The participant's page of a session.

    Attributes
    ----------
    hand
        The hand that moves the needle; None where nothing is moved.
    watchers
        What serves it.
    """

    page: "ParticipantPage"
    front: "PageFront"
    hand: "Operator | None"
    watchers: "tuple[Watcher[NodeEvent], ...]"


def check_page(page: str | None, simulate: str | None, operator: str | None = None) -> None:
    """Raise SettingsError if nobody would look at the page, or if it must be the hand but is not there."""
    from hapticnet.errors import SettingsError

    if page is not None and simulate is not None:
        raise SettingsError("--page is for a person; a simulated observer needs none")
    if page is None and operator == "page":
        raise SettingsError("--operator page needs --page")


@contextmanager
def opened(page: str | None, console: "Console") -> Iterator[OpenedPage | None]:
    """Yield the page that was asked for, if any, and print its address.

    Raises
    ------
    SettingsError
        If its address is malformed.
    UnavailableError
        If the extra is not installed or the address cannot be used.
    """
    from hapticnet.cli.pages import listen_for

    if page is None:
        yield None
        return
    sock, access = listen_for(page, ("operator",), console)
    with sock:
        console.say(f"{PARTICIPANT}{access.url('operator')}", needed=True)
        console.say("press Escape here to stop what the participant feels, Ctrl-C to interrupt the session")
        yield OpenedPage(sock, access, console.say)


def make_screen(opened: OpenedPage, hand: "Operator | None", source: str, *, masking_noise: bool) -> Screen:
    """Return the page of a session.

    Parameters
    ----------
    source
        Where the positions come from, in a word.
    masking_noise
        Whether masking noise begins with the first press on the page.
    """
    from hapticnet.study.page import ParticipantPage, SeenHand
    from hapticnet.study.page_front import PageFront
    from hapticnet.web.server import Server

    seen = None if hand is None else SeenHand(hand)
    page = ParticipantPage(seen, source, masking_noise=masking_noise, say=opened.say)
    return Screen(page, PageFront(page, opened.say), seen, (Server(page, opened.access, opened.sock), page))
