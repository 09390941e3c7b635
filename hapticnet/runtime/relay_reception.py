"""Whom the relay opens a client for: a client costs sockets, timers and a seat."""

from typing import Final

from hapticnet.errors import PeerError
from hapticnet.protocol.buckets import Buckets, TokenBucket
from hapticnet.protocol.cookies import CookieJar
from hapticnet.protocol.messages import HELLO_BYTES, Cookie
from hapticnet.protocol.settings import Entropy
from hapticnet.protocol.wire import Kind, pack, pack_body, unpack, unpack_body, unpack_nonce
from hapticnet.runtime.udp import SocketAddress, host_of

UNPROVED_PER_S: Final = 5.0
UNPROVED_AT_ONCE: Final = 16
"""Clients of all hosts together that are opened without a cookie, so that in normal use the relay only passes on. If
more ask, forged addresses may be among them."""

HOST_PER_S: Final = 5.0
HOST_AT_ONCE: Final = 32
"""Clients of one host that are opened."""

_FIVE_FIELDS: Final = 0x95
_LARGEST_FIXINT: Final = 0x7F
_AFTER_PROOF: Final = frozenset((Kind.WELCOME, Kind.FORCE, Kind.KEEPALIVE))


class RelayReception:
    """Read the datagrams of unknown sources.

    Attributes
    ----------
    ignored
        Datagrams that are not a HELLO.
    cookies
        Cookies sent to sources that had to prove their address.
    throttled
        Requests of hosts that sent too many.
    """

    def __init__(self, rng: Entropy) -> None:
        self.ignored = 0
        self.cookies = 0
        self.throttled = 0
        self._jar = CookieJar(rng)
        self._unproved = TokenBucket(UNPROVED_PER_S, UNPROVED_AT_ONCE)
        self._hosts = Buckets(HOST_PER_S, HOST_AT_ONCE)

    def greet(self, data: bytes, address: SocketAddress, now_us: int, *, must_prove: bool) -> bytes | bool:
        """Return whether to open a client for a source, or the COOKIE to answer.

        Parameters
        ----------
        must_prove
            Whether the source has to prove its address however few ask, because there is no free seat.
        """
        if not is_hello(data):
            self.ignored += 1
            return False
        try:
            datagram = unpack(data)
            nonce = unpack_nonce(datagram.body)
            cookie = unpack_body(datagram.body, 2)[1]
        except PeerError:
            self.ignored += 1
            return False
        place = repr(address).encode()
        if type(cookie) is bytes and self._jar.accepts(cookie, place, nonce, now_us):
            if self._hosts.take(host_of(address), now_us):
                return True
            self.throttled += 1
            return False
        if not must_prove and self._unproved.take(now_us):
            return True
        self.cookies += 1
        body = pack_body(Cookie(nonce, self._jar.make(place, nonce, now_us)))
        return pack(Kind.COOKIE, 0, 0, body, datagram.version)


def is_hello(data: bytes) -> bool:
    """Return whether a datagram has the size and the frame of a HELLO, of any version."""
    return len(data) >= HELLO_BYTES and data[0] == _FIVE_FIELDS and data[1] <= _LARGEST_FIXINT and data[2] == Kind.HELLO


def proves_session(data: bytes) -> bool:
    """Return whether a datagram of the target shows that its receiver has proved its address to it.

    COOKIE, REFUSE and RESET do not: anybody gets them.
    """
    return len(data) > 2 and data[2] in _AFTER_PROOF
