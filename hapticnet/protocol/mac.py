"""The code that a sealed HELLO carries: it shows that its sender knows the slave's public key.

Checking it takes one hash, computing a shared secret over a hundred times as long. A slave therefore drops a HELLO of
the wrong code before anything else, and does not answer those who scan for it.
"""

import functools
import hashlib
import hmac
import struct
from typing import Final

MAC_BYTES: Final = 16

_LABEL = b"hapticnet mac1"
_numbers = struct.Struct(">II").pack


def hello_mac(slave_public: bytes, nonce: int, sequence: int, noise1: bytes) -> bytes:
    """Return the code of a HELLO: `MAC_BYTES` bytes of keyed BLAKE2s (RFC 7693).

    Parameters
    ----------
    slave_public
        The slave's public key, 32 bytes.
    nonce, sequence
        The HELLO's nonce and its datagram's sequence number, unsigned 32-bit integers.
    noise1
        The first message of the handshake.
    """
    key = _key(slave_public)
    return hashlib.blake2s(_numbers(nonce, sequence) + noise1, key=key, digest_size=MAC_BYTES).digest()


def is_hello_mac(mac: bytes, slave_public: bytes, nonce: int, sequence: int, noise1: bytes) -> bool:
    """Return whether `mac` is the code of a HELLO, in a time that does not depend on the difference."""
    return hmac.compare_digest(mac, hello_mac(slave_public, nonce, sequence, noise1))


@functools.lru_cache(maxsize=8)
def _key(slave_public: bytes) -> bytes:
    return hashlib.blake2s(_LABEL + slave_public).digest()
