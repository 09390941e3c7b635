"""The checks that a HELLO must pass before the slave keeps or computes anything for its sender.

A cookie proves, without any state, that the sender receives datagrams at its address (as in DTLS, RFC 9147, section
5.1): it is a keyed hash of the address and the HELLO's nonce, so that only the slave can make one, and one made for
another address or HELLO is worthless. Token buckets limit how often requests are read.
"""

import hmac
from collections import OrderedDict
from collections.abc import Hashable, Mapping
from hashlib import blake2s
from typing import Final, TypeAlias

from hapticnet.errors import PeerError
from hapticnet.protocol.buckets import TokenBucket
from hapticnet.protocol.handshake import Door, Visitor
from hapticnet.protocol.messages import (
    COOKIE_BYTES,
    HELLO_BYTES,
    HELLO_SEQUENCE,
    Code,
    Cookie,
    Hello,
    Refuse,
    unpack_hello,
)
from hapticnet.protocol.settings import Entropy, random_bytes
from hapticnet.protocol.wire import OPEN, SEALED, Datagram, Kind, pack, pack_body, unpack_nonce

GENERATION_US: Final = 120_000_000
"""Time [µs] for which one secret makes cookies. Those of the previous secret are still accepted."""


class CookieJar:
    """Make cookies and recognise them."""

    def __init__(self, rng: Entropy) -> None:
        self._rng = rng
        self.generation: int | None = None  # number of the present secret; it changes every `GENERATION_US`
        self._secret = self._previous = b""

    def make(self, address: bytes, nonce: int, now_us: int) -> bytes:
        """Return the cookie for a HELLO with `nonce` from `address`."""
        self.renew(now_us)
        return _cookie(self._secret, address, nonce)

    def accepts(self, cookie: bytes, address: bytes, nonce: int, now_us: int) -> bool:
        """Return whether a cookie was made for that address and nonce within the last two generations."""
        if len(cookie) != COOKIE_BYTES:
            return False
        self.renew(now_us)
        return any(
            hmac.compare_digest(cookie, _cookie(secret, address, nonce)) for secret in (self._secret, self._previous)
        )

    def renew(self, now_us: int) -> None:
        """Change the secret if its time is over."""
        generation = now_us // GENERATION_US
        if generation == self.generation:
            return
        follows = self.generation is not None and generation == self.generation + 1
        self._previous = self._secret if follows else random_bytes(self._rng, 32)
        self._secret = random_bytes(self._rng, 32)
        self.generation = generation


def _cookie(secret: bytes, address: bytes, nonce: int) -> bytes:
    return blake2s(nonce.to_bytes(4, "big") + address, key=secret, digest_size=COOKIE_BYTES).digest()


MOST_KEYS: Final = 4096  # most keys remembered; the least recently used is forgotten


class Buckets:
    """One token bucket for each key, such as the host of an address. Memory is bounded."""

    def __init__(self, per_second: float, depth: float, most_keys: int = MOST_KEYS) -> None:
        self._per_second = per_second
        self._depth = depth
        self._most_keys = most_keys
        self._buckets: OrderedDict[Hashable, TokenBucket] = OrderedDict()

    def take(self, key: Hashable, now_us: int) -> bool:
        """Take a token from the bucket of `key`; return whether one was available."""
        bucket = self._buckets.get(key)
        if bucket is None:
            bucket = self._buckets[key] = TokenBucket(self._per_second, self._depth)
            if len(self._buckets) > self._most_keys:
                self._buckets.popitem(last=False)
        else:
            self._buckets.move_to_end(key)
        return bucket.take(now_us)


Address: TypeAlias = Hashable
"""Source or destination of a datagram. Opaque here; the runtime uses the socket module's form."""

REQUESTS_PER_S: Final = 5.0
REQUESTS_AT_ONCE: Final = 8
"""Requests of one host that are read: a sealed one costs a key exchange, an open one the tables of its codec."""

ALL_REQUESTS_PER_S: Final = 100.0
ALL_REQUESTS_AT_ONCE: Final = 10
"""Requests of all hosts together that are read. One takes up to a millisecond, during which positions wait."""


class HelloFilter:
    """Read HELLOs, in this order: size, version, key, cookie, rate, request.

    Before the cookie nothing is kept, and the costliest step is a hash. Requests of proved addresses are rate-limited,
    for each host and for all together.
    """

    def __init__(self, doors: Mapping[int, Door], rng: Entropy) -> None:
        self.throttled = 0  # requests not read because they came too often
        self.unkeyed = 0  # HELLOs of senders that do not know this slave's public key
        self._doors = doors
        self._jar = CookieJar(rng)
        self._hosts = Buckets(REQUESTS_PER_S, REQUESTS_AT_ONCE)
        self._all = TokenBucket(ALL_REQUESTS_PER_S, ALL_REQUESTS_AT_ONCE)
        self._generation: int | None = None
        self._spent: set[tuple[Address, int]] = set()
        self._spent_before: set[tuple[Address, int]] = set()

    def greet(self, datagram: Datagram, size: int, address: Address, now_us: int) -> Hello | bytes | None:
        """Return the HELLO if its sender has proved its address, an answer, or None; PeerError if it is malformed."""
        if size < HELLO_BYTES:
            raise PeerError(f"HELLO of {size} bytes; pad it to at least {HELLO_BYTES}")
        door = self._doors.get(datagram.version)
        if door is None:
            return self._refusal(unpack_nonce(datagram.body), datagram.version)
        if datagram.version == SEALED and not HELLO_SEQUENCE.has(datagram.sequence):
            raise PeerError(f"sealed HELLO with sequence {datagram.sequence}; it is at most {HELLO_SEQUENCE.largest}")
        hello = unpack_hello(datagram.body)
        if not door.is_for_us(hello, datagram.sequence):
            self.unkeyed += 1
            return None
        place = repr(address).encode()
        if self._jar.accepts(hello.cookie, place, hello.nonce, now_us):
            return hello
        body = pack_body(Cookie(hello.nonce, self._jar.make(place, hello.nonce, now_us)))
        return pack(Kind.COOKIE, 0, 0, body, datagram.version)

    def read(self, datagram: Datagram, hello: Hello, address: Address, host: Hashable, now_us: int) -> Visitor | None:
        """Read the request of a proved address; None if already read, or too many arrive. PeerError if malformed."""
        if self._is_spent(address, hello.nonce, now_us):
            return None
        if not (self._hosts.take(host, now_us) and self._all.take(now_us)):
            self.throttled += 1
            return None
        self._spent.add((address, hello.nonce))
        return self._doors[datagram.version].read(hello, datagram.sequence)

    def _is_spent(self, address: Address, nonce: int, now_us: int) -> bool:
        """Return whether a request with this nonce was read before: then this one is a copy or late."""
        self._jar.renew(now_us)
        if self._generation != self._jar.generation:  # earlier requests need a new cookie anyway
            self._generation = self._jar.generation
            self._spent_before, self._spent = self._spent, set()
        return (address, nonce) in self._spent or (address, nonce) in self._spent_before

    def _refusal(self, nonce: int, version: int) -> bytes:
        if version == OPEN:
            reason, code = "this slave serves sealed sessions only: give the master a key, with --peer-key", Code.KEY
        elif version == SEALED:
            reason = "this slave serves open sessions only: start it with --key for sealed ones, or omit --peer-key"
            code = Code.KEY
        else:
            reason, code = f"this slave speaks protocol versions {OPEN} and {SEALED} only", Code.VERSION
        return pack(Kind.REFUSE, 0, 0, pack_body(Refuse(nonce, reason, code)))
