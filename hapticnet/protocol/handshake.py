"""How a session begins: open ones (version 1) and sealed ones (version 2).

The master makes an `Attempt` for each session it asks for; the slave has a `Door` for each version it serves. Both
sides do the same with either: an open attempt sends its request as it is, a sealed one in the first message of a Noise
handshake, and the answer comes back in the second.
"""

from dataclasses import dataclass
from typing import Protocol

from hapticnet.errors import PeerError
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, Roster
from hapticnet.protocol.mac import hello_mac, is_hello_mac
from hapticnet.protocol.messages import (
    Grant,
    Hello,
    Refusal,
    Request,
    pack_hello,
    unpack_grant,
    unpack_grant_or_refusal,
    unpack_request,
)
from hapticnet.protocol.noise import Initiator, Responder, TransportKeys, public_key
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.settings import Entropy
from hapticnet.protocol.wire import OPEN, SEALED, pack_body


class Attempt(Protocol):
    """A master's attempt to get a session.

    Attributes
    ----------
    nonce
        Tells the answers to this attempt from all others.
    version
        Protocol version of the session asked for.
    """

    nonce: int
    version: int

    def hello(self, cookie: bytes) -> bytes:
        """Return the HELLO datagram."""
        ...

    def read(self, grant: bytes) -> tuple[Grant | Refusal, Seal | None]:
        """Return what a WELCOME grants, and the seal of the session; raise PeerError if it is not proved."""
        ...


class OpenAttempt:
    """An attempt to get an open session."""

    version = OPEN

    def __init__(self, request: Request, nonce: int, sequence: int) -> None:
        self.nonce = nonce
        self._request = pack_body(request)
        self._sequence = sequence

    def hello(self, cookie: bytes) -> bytes:
        """Return the HELLO datagram."""
        return pack_hello(Hello(self.nonce, cookie, self._request), self._sequence)

    def read(self, grant: bytes) -> tuple[Grant, None]:
        """Return what a WELCOME grants; raise PeerError if it is invalid."""
        return unpack_grant(grant), None


class SealedAttempt:
    """An attempt to get a sealed session."""

    version = SEALED

    def __init__(self, request: Request, nonce: int, sequence: int, key: MasterKey, rng: Entropy) -> None:
        self.nonce = nonce
        self._sequence = sequence
        self._has_psk = key.own.psk != NO_PSK
        self._initiator = Initiator(key.own.private, key.peer, key.own.psk, prologue(nonce, sequence), rng)
        self._noise1 = self._initiator.write(pack_body(request))
        self._mac = hello_mac(key.peer, nonce, sequence, self._noise1)

    def hello(self, cookie: bytes) -> bytes:
        """Return the HELLO datagram."""
        return pack_hello(Hello(self.nonce, cookie, self._noise1, self._mac), self._sequence, SEALED)

    def read(self, grant: bytes) -> tuple[Grant | Refusal, Seal]:
        """Return what a WELCOME grants, and the seal; raise PeerError unless the slave's key made it."""
        try:
            payload, keys = self._initiator.read(grant)
            answer = unpack_grant_or_refusal(payload)
        except PeerError:
            if not self._has_psk:
                raise
            # A slave that does not know a key knows no pre-shared key of it, and can only refuse.
            payload, keys = self._initiator.read(grant, NO_PSK)
            answer = unpack_grant_or_refusal(payload)
            if isinstance(answer, Grant):
                raise PeerError("a grant without the pre-shared key") from None
        return answer, Seal(keys.to_responder, keys.to_initiator)


@dataclass(frozen=True, slots=True)
class Visitor:
    """A master whose HELLO was read.

    Attributes
    ----------
    request
        The session it asks for.
    public
        Its public key, whether it is in the list of masters or not; None for an open session.
    entry
        Who it is, according to the list of masters; None if it is not in the list, or the session is open.
    responder
        The key exchange under way; None for an open session.
    """

    request: Request
    public: bytes | None
    entry: MasterEntry | None
    responder: Responder | None

    def answer(self, payload: Grant | Refusal) -> tuple[bytes, Seal | None]:
        """Return a grant or refusal as a WELCOME carries it, and the seal of the session."""
        packed = pack_body(payload)
        if self.responder is None:
            return packed, None
        psk = NO_PSK if self.entry is None else self.entry.psk
        noise2, keys = self.responder.write(packed, psk)
        return noise2, _slave_seal(keys)


class Door(Protocol):
    """How a slave reads the HELLOs of one version."""

    def is_for_us(self, hello: Hello, sequence: int) -> bool:
        """Return whether the sender knows this slave's public key, if one is needed. Cheap enough for every HELLO."""
        ...

    def read(self, hello: Hello, sequence: int) -> Visitor:
        """Read the request; PeerError if it is invalid. Costly: only for senders that have proved their address."""
        ...


class OpenDoor:
    """Serve open sessions."""

    def is_for_us(self, hello: Hello, sequence: int) -> bool:  # noqa: ARG002 - no key is needed
        """Return True."""
        return True

    def read(self, hello: Hello, sequence: int) -> Visitor:  # noqa: ARG002 - nothing is bound to it
        """Read the request; PeerError if it is invalid."""
        return Visitor(unpack_request(hello.request), None, None, None)


class SealedDoor:
    """Serve sealed sessions to the masters of a list.

    Parameters
    ----------
    private
        The slave's private key, 32 bytes.
    roster
        The masters that are served. Assign another one to change the list.
    """

    def __init__(self, private: bytes, roster: Roster, rng: Entropy) -> None:
        self.roster = roster
        self._private = private
        self._public = public_key(private)
        self._rng = rng

    def is_for_us(self, hello: Hello, sequence: int) -> bool:
        """Return whether the sender knows this slave's public key."""
        return is_hello_mac(hello.mac, self._public, hello.nonce, sequence, hello.request)

    def read(self, hello: Hello, sequence: int) -> Visitor:
        """Do the slave's first half of the key exchange; PeerError if the HELLO cannot be opened."""
        responder = Responder(self._private, prologue(hello.nonce, sequence), self._rng)
        public, payload = responder.read(hello.request)
        return Visitor(unpack_request(payload), public, self.roster.find(public), responder)


def prologue(nonce: int, sequence: int) -> bytes:
    """Return what both sides must agree on before the key exchange: the readable parts of the HELLO."""
    return b"hapticnet 2" + nonce.to_bytes(4, "big") + sequence.to_bytes(4, "big")


def _slave_seal(keys: TransportKeys) -> Seal:
    return Seal(keys.to_initiator, keys.to_responder)
