"""Who has the hand: one page at a time."""

from hapticnet.errors import PeerError
from hapticnet.operator.live import HandState, LiveHand
from hapticnet.web.client import Client
from hapticnet.web.requests import Hand


class Seat:
    """The hand and the page that has it.

    `hand`: the hand; None if the positions come from elsewhere.
    """

    def __init__(self, hand: LiveHand | None) -> None:
        self.holder: Client | None = None  # the page that has it, or None
        self._hand = hand

    @property
    def state(self) -> HandState:
        """What the hand is doing."""
        return HandState.FREE if self._hand is None else self._hand.state

    def take(self, client: Client) -> None:
        """Give the hand to a page; raise PeerError if another one has it or there is none."""
        if self._hand is None:
            raise PeerError("the positions of this run come from elsewhere; there is no hand to take")
        if self.holder is not None and self.holder is not client:
            raise PeerError("another page moves the needle")
        self.holder = client
        self._hand.take()

    def move(self, client: Client, hand: Hand) -> None:
        """Move the hand, if this page has it. Otherwise it has just lost it, which is not its mistake."""
        client.heard = hand
        if self._hand is not None and client is self.holder:
            self._hand.move(hand.position_m)

    def release(self, client: Client) -> None:
        """Take the hand back from a page, if it has it."""
        if client is self.holder:
            self.let_go()

    def let_go(self) -> None:
        """Withdraw the needle and free the hand, whoever has it."""
        self.holder = None
        if self._hand is not None and self._hand.state is not HandState.FREE:
            self._hand.release()

    def check(self) -> None:
        """Take the hand back from a page that was silent for too long."""
        if self.holder is not None and self.state in (HandState.WITHDRAWING, HandState.FREE):
            self.holder = None
