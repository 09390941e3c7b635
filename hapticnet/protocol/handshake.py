"""The start of open (version 1) and sealed (version 2) sessions.

The master makes an `Attempt` for each session it asks for; the slave has a `Door` for each version it serves. An open
attempt sends its request unencrypted, a sealed one in the first message of a Noise handshake, and the answer is in
the second. `Asking` repeats the HELLO of an attempt, with the cookie and at growing intervals, until an answer comes.
"""

import functools
import hashlib
import hmac
import math
import struct
from typing import Final, NamedTuple

from hapticnet.errors import PeerError
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, Roster
from hapticnet.protocol.messages import (
    Grant,
    Hello,
    Refusal,
    Request,
    pack_contents,
    pack_hello,
    unpack_cookie,
    unpack_grant,
    unpack_grant_or_refusal,
    unpack_refuse,
    unpack_request,
    unpack_welcome,
)
from hapticnet.protocol.noise import Initiator, Responder, public_key
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.settings import Entropy, SessionSettings
from hapticnet.protocol.states import Hinted
from hapticnet.protocol.wire import MODULUS, OPEN, SEALED, Datagram, Kind

MAC_BYTES: Final = 16

_LABEL = b"hapticnet mac1"
_numbers = struct.Struct(">II").pack


def hello_mac(slave_public: bytes, nonce: int, sequence: int, noise1: bytes) -> bytes:
    """Return the code of a sealed HELLO: `MAC_BYTES` bytes of keyed BLAKE2s (RFC 7693).

    It shows that the sender knows the slave's public key. Checking it takes one hash, computing a shared secret over a
    hundred times as long. A slave therefore drops a HELLO with a wrong code before anything else, and does not answer
    scanners.
    """
    key = _mac_key(slave_public)
    return hashlib.blake2s(_numbers(nonce, sequence) + noise1, key=key, digest_size=MAC_BYTES).digest()


def is_hello_mac(mac: bytes, slave_public: bytes, nonce: int, sequence: int, noise1: bytes) -> bool:
    """Return whether `mac` is the code of a HELLO, in a time that does not depend on the difference."""
    return hmac.compare_digest(mac, hello_mac(slave_public, nonce, sequence, noise1))


@functools.lru_cache(maxsize=8)
def _mac_key(slave_public: bytes) -> bytes:
    return hashlib.blake2s(_LABEL + slave_public).digest()


def prologue(nonce: int, sequence: int) -> bytes:
    """Return the data that both sides must share before the key exchange: the readable parts of the HELLO."""
    return b"hapticnet 2" + nonce.to_bytes(4, "big") + sequence.to_bytes(4, "big")


class Attempt:
    """A master's attempt to get an open session. `nonce` distinguishes the answers to this attempt from all others."""

    def __init__(self, request: Request, nonce: int, sequence: int) -> None:
        self.version = OPEN
        self.nonce = nonce
        self._sequence = sequence
        self._request = pack_contents(request)
        self._mac = b""

    def hello(self, cookie: bytes) -> bytes:
        """Return the HELLO datagram."""
        return pack_hello(Hello(self.nonce, cookie, self._request, self._mac), self._sequence, self.version)

    def read(self, grant: bytes) -> tuple[Grant | Refusal, Seal | None]:
        """Return the grant in a WELCOME, and the seal of the session; raise PeerError if it is not proved."""
        return unpack_grant(grant), None


class SealedAttempt(Attempt):
    """A master's attempt to get a sealed session."""

    def __init__(self, request: Request, nonce: int, sequence: int, key: MasterKey, rng: Entropy) -> None:
        super().__init__(request, nonce, sequence)
        self.version = SEALED
        self._has_psk = key.own.psk != NO_PSK
        self._initiator = Initiator(key.own.private, key.peer, key.own.psk, prologue(nonce, sequence), rng)
        self._request = self._initiator.write(self._request)
        self._mac = hello_mac(key.peer, nonce, sequence, self._request)

    def read(self, grant: bytes) -> tuple[Grant | Refusal, Seal | None]:
        """Return the grant in a WELCOME, and the seal; raise PeerError unless the slave's key made it."""
        try:
            payload, keys = self._initiator.read(grant)
            answer = unpack_grant_or_refusal(payload)
        except PeerError:
            if not self._has_psk:
                raise
            # A slave that does not know a key has no pre-shared key for it, and can only refuse.
            payload, keys = self._initiator.read(grant, NO_PSK)
            answer = unpack_grant_or_refusal(payload)
            if isinstance(answer, Grant):
                raise PeerError("a grant without the pre-shared key") from None
        return answer, Seal(keys.to_responder, keys.to_initiator)


class Visitor(NamedTuple):
    """A master whose HELLO was read."""

    request: Request
    public: bytes | None  # its public key, in the list of masters or not; None: open session
    entry: MasterEntry | None  # its entry in the list of masters; None: not listed, or open session
    responder: Responder | None  # the key exchange under way; None: open session

    def answer(self, payload: Grant | Refusal) -> tuple[bytes, Seal | None]:
        """Return a grant or refusal as a WELCOME carries it, and the seal of the session."""
        packed = pack_contents(payload)
        if self.responder is None:
            return packed, None
        noise2, keys = self.responder.write(packed, NO_PSK if self.entry is None else self.entry.psk)
        return noise2, Seal(keys.to_initiator, keys.to_responder)


class Door:
    """How a slave reads the HELLOs of open sessions."""

    def is_for_us(self, hello: Hello, sequence: int) -> bool:  # noqa: ARG002 - no key is needed
        """Return whether the sender knows this slave's public key, if one is needed. Cheap enough for every HELLO."""
        return True

    def read(self, hello: Hello, sequence: int) -> Visitor:  # noqa: ARG002 - nothing is bound to it
        """Read the request; PeerError if it is invalid. Costly: only for senders that have proved their address."""
        return Visitor(unpack_request(hello.request), None, None, None)


class SealedDoor(Door):
    """How a slave reads the HELLOs of sealed sessions. Assign another `roster` to change the served masters."""

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


GROWTH: Final = 1.25  # growth of each interval while HELLOs back off
FRESH_AFTER_US: Final = 4_000_000
"""Time [µs] after the first cookie of an attempt after which an unanswered attempt is replaced by a new one. The slave
reads each request once, so repeating one does not help if the slave has forgotten the session."""


class Granted(NamedTuple):
    """A session: the grant, the seal (None if it is open), and the sequence number that the slave counts from."""

    grant: Grant
    seal: Seal | None
    sequence: int


class Asking:
    """Ask for a session, one attempt at a time. `under_way` says whether one is in progress."""

    def __init__(self, request: Request, settings: SessionSettings, rng: Entropy, key: MasterKey | None) -> None:
        self.under_way = False
        self._request = request
        self._settings = settings
        self._rng = rng
        self._key = key
        self._attempt: Attempt | None = None
        self._cookie = b""
        self._cookie_us = 0
        self._hinted = False
        self._tries = 0
        self._tried_us: int | None = None
        self._interval_us = settings.hello_interval_us
        self._wait_us = settings.refused_retry_us

    def begin(self, ticket: bytes | None) -> None:
        """Ask for a session that continues the scene of `ticket`; do nothing if an attempt is in progress."""
        if self.under_way:
            return
        self.under_way = True
        self._request = self._request._replace(ticket=ticket)
        self._tries = 0
        self._interval_us = self._settings.hello_interval_us

    def ask_for(self, request: Request) -> Request:
        """Ask for another session from now on; return the previous request. Ignore answers to earlier HELLOs."""
        before, self._request = self._request, request._replace(ticket=self._request.ticket)
        self._attempt = None
        self._tried_us = None
        return before

    def stop(self) -> None:
        """Stop asking."""
        self.under_way = False
        self._attempt = None

    def tick(self, now_us: int) -> bytes | None:
        """Return the HELLO to send now, if it is time for one."""
        if not self.under_way:
            return None
        # If the clock went back, the elapsed time is unknown.
        if self._tried_us is not None and 0 <= now_us - self._tried_us < self._interval_us:
            return None
        attempt = self._attempt
        if attempt is None or (self._cookie and now_us - self._cookie_us > FRESH_AFTER_US):
            request = self._request._replace(clock_us=now_us)
            nonce, sequence = int(self._rng.integers(0, MODULUS)), self._settings.first_sequence
            if self._key is None:
                attempt = Attempt(request, nonce, sequence)
            else:
                attempt = SealedAttempt(request, nonce, sequence, self._key, self._rng)
            self._attempt = attempt
            self._cookie = b""
            self._hinted = False
            if not self._tries:
                self._interval_us = self._settings.hello_interval_us
        self._tries += 1
        if self._tries > self._settings.quick_hellos:
            self._interval_us = min(round(self._interval_us * GROWTH), self._settings.slowest_hello_us)
        self._tried_us = now_us
        return attempt.hello(self._cookie)

    def receive(self, datagram: Datagram, now_us: int) -> Granted | Refusal | Hinted | bytes | None:
        """Process a COOKIE, WELCOME or REFUSE.

        Return a session, a refusal, a hint (a refusal that should be sealed and is not), the HELLO to send now, or None
        if the answer is to another HELLO or changes nothing. Raise PeerError if it is malformed, or its seal is not the
        slave's.
        """
        if datagram.kind is Kind.COOKIE:
            cookie = unpack_cookie(datagram.body)
            attempt = self._attempt_of(cookie.nonce)
            is_first, self._cookie = not self._cookie, self._cookie if attempt is None else cookie.cookie
            if attempt is None or not is_first:  # only the first cookie of an attempt is answered at once
                return None
            self._cookie_us = self._tried_us = now_us
            return attempt.hello(self._cookie)
        if datagram.kind is Kind.WELCOME:
            welcome = unpack_welcome(datagram.body)
            attempt = self._attempt_of(welcome.nonce)
            if attempt is None or attempt.version != datagram.version:
                return None
            grant, seal = attempt.read(welcome.grant)
            # The seal does not cover the frame of a WELCOME: a forged sequence would make true datagrams late.
            sequence = datagram.sequence if seal is None else 0
            if isinstance(grant, Grant):
                self._check(grant)
            return Granted(grant, seal, sequence) if isinstance(grant, Grant) else grant
        refuse = unpack_refuse(datagram.body)
        attempt = self._attempt_of(refuse.nonce)
        if attempt is None:
            return None
        if attempt.version == OPEN:
            return Refusal(0, refuse.reason, refuse.code)
        if self._hinted:
            return None
        self._hinted = True  # report only one per attempt, because a thousand are as easy to forge
        return Hinted(refuse.reason)

    def _check(self, grant: Grant) -> None:
        """Raise PeerError if a grant contains something not requested: raw positions, for instance, are a choice."""
        if grant.announced and not self._request.announced:
            raise PeerError("the grant announces the contact ahead, which was not asked for")
        if grant.predicted and not self._request.predicted:
            raise PeerError("the grant predicts the hand, which was not asked for")
        if grant.vibration and self._request.vibration is None:
            raise PeerError("the grant sends vibration, which was not asked for")
        share, asked = grant.position_share, self._request.position_share
        if share and not math.isclose(share, asked, rel_tol=1e-6):  # a peer may compute with float32
            raise PeerError(f"the grant gives positions a share of {share:g} of the JND; {asked:g} was asked for")

    def granted(self) -> None:
        """Note that a session exists."""
        self.stop()
        self._wait_us = self._settings.refused_retry_us

    def refused(self, now_us: int) -> int:
        """Note a refusal; return how long [µs] until the next try."""
        self._attempt = None
        wait_us = self._wait_us
        self._wait_us = min(2 * wait_us, self._settings.slowest_retry_us)
        self._interval_us = wait_us
        self._tries = 0
        self._tried_us = now_us
        return wait_us

    def _attempt_of(self, nonce: int) -> Attempt | None:
        return self._attempt if self._attempt is not None and self._attempt.nonce == nonce else None
