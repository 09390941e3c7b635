"""What a slave that shares its address with other workers needs from them.

A HELLO may arrive at any worker, which checks the address of its sender. Up to two other workers follow: the desk of
its host, which counts the requests of that host and reads this one, and the worker that gets the session.
"""

from collections.abc import Hashable
from enum import IntEnum
from typing import NamedTuple, Protocol

from hapticnet.node.reception import Address
from hapticnet.protocol.handshake import Visitor
from hapticnet.protocol.messages import Request


class Stage(IntEnum):
    """How far a HELLO has come when a worker gets it."""

    ARRIVED = 0
    """It comes from the network."""

    COUNT = 1
    """Its host's requests are counted here."""

    ADMIT = 2
    """It was counted, and its session is to be here."""


class PassedOn(NamedTuple):
    """A HELLO for another worker."""

    worker: int
    stage: Stage
    data: bytes
    address: Address


class Neighbours(Protocol):
    """The other workers, as one of them sees them. A worker that does not run is never named."""

    def desk(self, host: Hashable) -> int | None:
        """Return the worker that counts the requests of a host; None if that is this one."""
        ...

    def placed(self, address: Address, nonce: int) -> int | None:
        """Return the other worker that a HELLO was given to before; None if it was not."""
        ...

    def place(self, address: Address, nonce: int, identity: Hashable, seats: int, request: Request) -> int | None:
        """Choose the worker for a session of `identity`, which may have so many `seats`; None if that is this one."""
        ...

    def held(self, identity: Hashable) -> int:
        """Return how many sessions of an identity the others have."""
        ...

    def taken(self) -> int:
        """Return how many sessions the others have."""
        ...


class Alone:
    """There are no others."""

    def desk(self, host: Hashable) -> int | None:  # noqa: ARG002
        """Return None."""
        return None

    def placed(self, address: Address, nonce: int) -> int | None:  # noqa: ARG002
        """Return None."""
        return None

    def place(
        self,
        address: Address,  # noqa: ARG002
        nonce: int,  # noqa: ARG002
        identity: Hashable,  # noqa: ARG002
        seats: int,  # noqa: ARG002
        request: Request,  # noqa: ARG002
    ) -> int | None:
        """Return None."""
        return None

    def held(self, identity: Hashable) -> int:  # noqa: ARG002
        """Return 0."""
        return 0

    def taken(self) -> int:
        """Return 0."""
        return 0


class Passing:
    """Give HELLOs to the workers they belong to.

    Parameters
    ----------
    seats
        Sessions of one identity, unless the list of masters says another number.

    Attributes
    ----------
    outbox
        What is to be passed on. Take it away.
    """

    def __init__(self, neighbours: Neighbours, seats: int) -> None:
        self.outbox: list[PassedOn] = []
        self._neighbours = neighbours
        self._seats = seats

    def unread(self, data: bytes, address: Address, nonce: int, host: Hashable, stage: Stage) -> bool:
        """Pass a HELLO on before it is read, if another worker counts it or has been given it; return whether."""
        if stage is Stage.ARRIVED and (desk := self._neighbours.desk(host)) is not None:
            return self._pass_on(desk, Stage.COUNT, data, address)
        if stage is not Stage.ADMIT and (worker := self._neighbours.placed(address, nonce)) is not None:
            return self._pass_on(worker, Stage.ADMIT, data, address)
        return False

    def read(self, data: bytes, address: Address, nonce: int, host: Hashable, visitor: Visitor, stage: Stage) -> bool:
        """Pass a HELLO on that was read, if its session is to be elsewhere; return whether."""
        entry = visitor.entry
        if stage is Stage.ADMIT or (visitor.responder is not None and entry is None):  # which is refused here
            return False
        seats = self._seats if entry is None or entry.most_sessions is None else entry.most_sessions
        worker = self._neighbours.place(address, nonce, identity_of(visitor, host), seats, visitor.request)
        return worker is not None and self._pass_on(worker, Stage.ADMIT, data, address)

    def _pass_on(self, worker: int, stage: Stage, data: bytes, address: Address) -> bool:
        self.outbox.append(PassedOn(worker, stage, data, address))
        return True


def identity_of(visitor: Visitor, host: Hashable) -> Hashable:
    """Return whom a session counts for: a public key or, without keys, a host."""
    return host if visitor.entry is None else visitor.entry.public
