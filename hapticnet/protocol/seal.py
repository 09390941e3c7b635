"""Seal and open the datagrams of a session whose ends have agreed on keys.

A sealed datagram has the frame of an open one. Its body is ChaCha20-Poly1305 (RFC 8439) of the message's fields: the
nonce is the sequence number, and everything before the body's msgpack head is authenticated unencrypted. The key of a
direction changes every 2²⁰ sequence numbers, 17 minutes at 1 kHz, without a message: a key found later does not open
earlier datagrams.
"""

import struct
from collections.abc import Callable
from typing import Final

import msgpack
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from hapticnet.errors import PeerError
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES, MODULUS, SEALED, Datagram

TAG_BYTES: Final = 16  # bytes that a seal adds to a body
EPOCH_BITS: Final = 20  # a key is used for 2²⁰ sequence numbers, one epoch
LAST_SEQUENCE: Final = 2**32 - 2**16
"""The last sequence number under one handshake's keys: a number is a nonce and must not repeat. A master that gets
near it asks for a continuing session with new keys."""

_pack_number: Callable[[int], bytes] = msgpack.Packer().pack  # return the shortest msgpack of an integer


class Seal:
    """One end of a sealed session: it seals what it sends and opens what it receives.

    Both directions start in epoch 0. A receiver opens datagrams of the newest epoch seen, the previous one and the
    next one. Keys of earlier epochs are released.
    """

    def __init__(self, send_key: bytes, receive_key: bytes) -> None:
        self.send_epoch = 0
        self._send = ChaCha20Poly1305(send_key)
        self._sent = -1
        self._heads: dict[tuple[int, int], bytes] = {}
        self.receive_epoch = 0
        self._receive = ChaCha20Poly1305(receive_key)
        self._behind: ChaCha20Poly1305 | None = None
        self._ahead: ChaCha20Poly1305 | None = None

    def pack(self, kind: int, session: int, sequence: int, body: bytes) -> bytes:
        """Return a sealed datagram.

        `kind`, `session`, `sequence`: the first elements of the frame. `sequence` must be above that of every earlier
        datagram and below 2³²; otherwise ValueError, because two datagrams under one nonce reveal both.
        """
        if not self._sent < sequence < MODULUS:
            raise ValueError(f"sequence number {sequence} after {self._sent}; each is used once, up to {MODULUS - 1}")
        while sequence >> EPOCH_BITS != self.send_epoch:
            self._send = ChaCha20Poly1305(_next_key(self._send))
            self.send_epoch += 1
        self._sent = sequence
        head = self._heads.get((kind, session)) or self._head(kind, session)
        head += _pack_number(sequence)
        sealed = self._send.encrypt(_nonce(sequence), body, head)
        return head + _BIN_HEADS[len(sealed)] + sealed

    def open(self, data: bytes, datagram: Datagram) -> bytes:
        """Return the opened body; PeerError if key or data differ, or it is two epochs away. That changes nothing."""
        sequence = datagram.sequence
        body = datagram.body
        # A head longer than the shortest cannot pass: it would put one more byte before it than the sender sealed.
        end = -2 - len(body) if len(body) < 256 else -3 - len(body)
        if sequence >> EPOCH_BITS != self.receive_epoch:
            return self._open_beside(sequence, body, data[:end])
        try:
            return self._receive.decrypt(_nonce(sequence), body, data[:end])
        except InvalidTag:
            raise PeerError(_NOT_OPENED) from None

    def _open_beside(self, sequence: int, body: bytes, head: bytes) -> bytes:
        """Open a datagram of an epoch other than the current one; follow the sender to the next epoch."""
        epochs = (sequence >> EPOCH_BITS) - self.receive_epoch
        if epochs == -1 and self._behind:
            cipher = self._behind
        elif epochs == 1:
            # Kept for the next try: each datagram of a forged flood must not derive a key.
            cipher = self._ahead = self._ahead or ChaCha20Poly1305(_next_key(self._receive))
        else:
            raise PeerError(f"sealed datagram {sequence} is {epochs} epochs away; only the next and last ones open")
        try:
            opened = cipher.decrypt(_nonce(sequence), body, head)
        except InvalidTag:
            raise PeerError(_NOT_OPENED) from None
        if epochs == 1:
            self._behind, self._receive, self._ahead = self._receive, cipher, None
            self.receive_epoch += 1
        return opened

    def _head(self, kind: int, session: int) -> bytes:
        """Return the first bytes of a datagram, up to its sequence number."""
        head = self._heads[kind, session] = b"\x95" + b"".join(map(_pack_number, (SEALED, kind, session)))
        return head


_NOT_OPENED = "sealed datagram that does not open: wrong key, or changed in transit"

_nonce = struct.Struct("<4xQ").pack  # the nonce of a sequence number (Noise revision 34, §12.3)
_REKEY_NONCE = _nonce(2**64 - 1)


def _next_key(cipher: ChaCha20Poly1305) -> bytes:
    """Return the key of the next epoch: REKEY of Noise (revision 34, §4.2)."""
    return cipher.encrypt(_REKEY_NONCE, bytes(32), b"")[:32]


def _bin_head(length: int) -> bytes:
    """Return the msgpack head of a byte string: bin 8 or bin 16."""
    return bytes([0xC4, length]) if length < 256 else b"\xc5" + length.to_bytes(2, "big")


_BIN_HEADS = [_bin_head(length) for length in range(MAX_DATAGRAM_BYTES + 1)]
