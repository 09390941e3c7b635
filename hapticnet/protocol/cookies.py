"""Cookies: proof, without any state, that the sender of a HELLO receives what is sent to its address.

The idea is that of DTLS (RFC 9147, section 5.1). A cookie is a keyed hash of the address and the HELLO's nonce, so that
only the slave can make one, and one made for another address or HELLO is worth nothing.
"""

import hmac
from hashlib import blake2s
from typing import Final

from hapticnet.protocol.messages import COOKIE_BYTES
from hapticnet.protocol.settings import Entropy, random_bytes

GENERATION_US: Final = 120_000_000
"""How long [µs] one secret makes cookies. Those of the previous secret are still accepted."""


class CookieJar:
    """Make cookies and recognise them.

    Attributes
    ----------
    generation
        Number of the present secret; it changes every `GENERATION_US`.
    """

    __slots__ = ("_previous", "_rng", "_secret", "generation")

    def __init__(self, rng: Entropy) -> None:
        self._rng = rng
        self.generation: int | None = None
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
