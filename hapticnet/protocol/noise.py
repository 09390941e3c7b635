"""The handshake that gives a sealed session its keys: Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s.

The master is the initiator and knows the slave's public key beforehand. Two messages make two keys, one per direction:

    -> e, es, s, ss
    <- e, ee, se, psk

The first message hides and authenticates the master's public key and its payload. An observer can replay it, so nothing
may be granted for it before the master proves that it has the keys. Both messages are as long as their payload and
`MESSAGE_1_BYTES` or `MESSAGE_2_BYTES`.

Source: Trevor Perrin, The Noise Protocol Framework, revision 34 (2018), https://noiseprotocol.org/noise.html. Section
numbers in this module are that document's.
"""

import functools
import hashlib
import hmac
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from hapticnet.errors import PeerError, SettingsError
from hapticnet.protocol.settings import Entropy, random_bytes

NAME: Final = b"Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s"

KEY_BYTES: Final = 32
"""Length of private, public, shared and transport keys (§4.1, §12.1) and of hashes (BLAKE2s, §12.7)."""

TAG_BYTES: Final = 16  # length of a ciphertext's tag (§4.2)
MESSAGE_1_BYTES: Final = 2 * KEY_BYTES + 2 * TAG_BYTES
"""Length of the first message without its payload: an ephemeral key, a sealed static key and the payload's tag."""

MESSAGE_2_BYTES: Final = KEY_BYTES + TAG_BYTES
"""Length of the second message without its payload: an ephemeral key and the payload's tag."""


class TransportKeys(NamedTuple):
    """The keys of a session, 32 bytes each."""

    to_responder: bytes
    to_initiator: bytes

    def __repr__(self) -> str:
        return "TransportKeys(…)"  # so that no log or traceback shows them


def public_key(private: bytes) -> bytes:
    """Return the public key of a private key, 32 bytes each; raise SettingsError for any other length."""
    return _pair(private).public


class Initiator:
    """The master's side of a handshake.

    `psk`: the key shared beforehand, 32 bytes; `keys.NO_PSK` where there is none.
    `prologue`: data that both ends share. The handshake fails unless they are equal (§6).
    Raise SettingsError if a key is not 32 bytes, or if `peer` is a point of low order, with which every shared secret
    is zero.
    """

    def __init__(self, static: bytes, peer: bytes, psk: bytes, prologue: bytes, rng: Entropy) -> None:
        _check_length(peer, "public key")
        _check_length(psk, "pre-shared key")
        self._static = _pair(static)
        self._peer = peer
        self._psk = psk
        self._rng = rng
        try:
            self._static_shared = _shared_secret(self._static, peer)
        except PeerError as error:
            raise SettingsError(f"the public key {peer.hex()} belongs to nobody: it is a point of low order") from error
        self._start = _Transcript.begin(prologue, peer)
        self._ephemeral: _Pair | None = None
        self._written = self._start

    def write(self, payload: bytes) -> bytes:
        """Return the first message. Each call starts the handshake again, with a fresh ephemeral key."""
        transcript = self._start.copy()
        ephemeral = _new_pair(self._rng)
        transcript.mix_ephemeral(ephemeral.public)
        transcript.mix_key(_shared_secret(ephemeral, self._peer))
        static = transcript.encrypt(self._static.public)
        transcript.mix_key(self._static_shared)
        message = ephemeral.public + static + transcript.encrypt(payload)
        self._ephemeral, self._written = ephemeral, transcript
        return message

    def read(self, message: bytes, psk: bytes | None = None) -> tuple[bytes, TransportKeys]:
        """Return the payload of the second message, and the session's keys; `psk` replaces this side's own.

        A refused message changes nothing: the true answer can still be read. Raise PeerError if the message is
        too short, changed, or not from the holder of the peer's private key and of `psk` in answer to the last message
        written.
        """
        if self._ephemeral is None:
            raise RuntimeError("write the first message before reading the second")
        _check_message(message, MESSAGE_2_BYTES)
        transcript = self._written.copy()
        theirs = message[:KEY_BYTES]
        transcript.mix_ephemeral(theirs)
        transcript.mix_key(_shared_secret(self._ephemeral, theirs))
        transcript.mix_key(_shared_secret(self._static, theirs))
        transcript.mix_psk(self._psk if psk is None else psk)
        payload = transcript.decrypt(message[KEY_BYTES:])
        return payload, transcript.split()


class Responder:
    """The slave's side of a handshake; SettingsError if `static` is not 32 bytes."""

    def __init__(self, static: bytes, prologue: bytes, rng: Entropy) -> None:
        self._static = _pair(static)
        self._rng = rng
        self._start = _Transcript.begin(prologue, self._static.public)
        self._accepted: tuple[_Transcript, bytes, bytes] | None = None

    def read(self, message: bytes) -> tuple[bytes, bytes]:
        """Return the initiator's static public key (32 bytes), which is authentic, and the payload.

        The message may be a replay of an earlier one (§7.7: payload security 1 of the source, 2 of the destination).
        Raise PeerError if the message is too short, changed, or written for another public key or prologue.
        """
        _check_message(message, MESSAGE_1_BYTES)
        transcript = self._start.copy()
        ephemeral = message[:KEY_BYTES]
        transcript.mix_ephemeral(ephemeral)
        transcript.mix_key(_shared_secret(self._static, ephemeral))
        end = 2 * KEY_BYTES + TAG_BYTES
        static = transcript.decrypt(message[KEY_BYTES:end])
        transcript.mix_key(_shared_secret(self._static, static))
        payload = transcript.decrypt(message[end:])
        self._accepted = transcript, ephemeral, static
        return static, payload

    def write(self, payload: bytes, psk: bytes) -> tuple[bytes, TransportKeys]:
        """Return the second message, of `MESSAGE_2_BYTES` and the payload's length, and the session's keys.

        The keys prove nothing about the initiator until a message under `to_responder` opens.
        """
        if self._accepted is None:
            raise RuntimeError("read the first message before writing the second")
        _check_length(psk, "pre-shared key")
        accepted, their_ephemeral, their_static = self._accepted
        transcript = accepted.copy()
        ephemeral = _new_pair(self._rng)
        transcript.mix_ephemeral(ephemeral.public)
        transcript.mix_key(_shared_secret(ephemeral, their_ephemeral))
        transcript.mix_key(_shared_secret(ephemeral, their_static))
        transcript.mix_psk(psk)
        message = ephemeral.public + transcript.encrypt(payload)
        return message, transcript.split()


class _Pair(NamedTuple):
    """A private key, ready for use, and its public key."""

    private: X25519PrivateKey
    public: bytes


class _Transcript:
    """The state of a handshake (§5.2): chaining key, hash of the transcript, and the key of the next ciphertext.

    In this pattern every key encrypts once, because a key is mixed in before every ciphertext. All nonces are therefore
    zero, and there is no counter.
    """

    def __init__(self, chain: bytes, hash_: bytes, key: bytes = b"") -> None:
        self._chain, self._hash, self._key = chain, hash_, key

    @classmethod
    def begin(cls, prologue: bytes, responder: bytes) -> "_Transcript":
        # NAME is longer than a hash, so both start as its hash; then prologue and pre-message are mixed in (§5.3).
        chain = _hash(NAME)
        return cls(chain, _hash(_hash(chain + prologue) + responder))

    def copy(self) -> "_Transcript":
        return _Transcript(self._chain, self._hash, self._key)

    def mix_ephemeral(self, public: bytes) -> None:
        """Mix an ephemeral public key into hash and key: patterns with a pre-shared key do both (§9.2)."""
        self._hash = _hash(self._hash + public)
        self.mix_key(public)

    def mix_key(self, material: bytes) -> None:
        self._chain, self._key = _derive(self._chain, material, 2)

    def mix_psk(self, psk: bytes) -> None:
        self._chain, mixed, self._key = _derive(self._chain, psk, 3)
        self._hash = _hash(self._hash + mixed)

    def encrypt(self, plaintext: bytes) -> bytes:
        ciphertext = ChaCha20Poly1305(self._key).encrypt(_NONCE, plaintext, self._hash)
        self._hash = _hash(self._hash + ciphertext)
        return ciphertext

    def decrypt(self, ciphertext: bytes) -> bytes:
        try:
            plaintext = ChaCha20Poly1305(self._key).decrypt(_NONCE, ciphertext, self._hash)
        except InvalidTag as error:
            raise PeerError("handshake message that does not open: wrong keys, or changed in transit") from error
        self._hash = _hash(self._hash + ciphertext)
        return plaintext

    def split(self) -> TransportKeys:
        to_responder, to_initiator = _derive(self._chain, b"", 2)
        return TransportKeys(to_responder, to_initiator)


_NONCE = bytes(12)


def _hash(data: bytes) -> bytes:
    return hashlib.blake2s(data).digest()


def _derive(chain: bytes, material: bytes, count: int) -> list[bytes]:
    """Return `count` keys from the chaining key and key material (§4.3, HKDF)."""
    secret = _hmac(chain, material)
    outputs = [_hmac(secret, b"\x01")]
    for number in range(2, count + 1):
        outputs.append(_hmac(secret, outputs[-1] + bytes([number])))
    return outputs


def _hmac(key: bytes, data: bytes) -> bytes:
    """Return HMAC-BLAKE2s (RFC 2104): Noise uses it instead of BLAKE2's own keyed mode (§4.3)."""
    return hmac.digest(key, data, "blake2s")


def _shared_secret(ours: _Pair, theirs: bytes) -> bytes:
    try:
        return ours.private.exchange(X25519PublicKey.from_public_bytes(theirs))
    # `exchange` raises ValueError if the result is zero: `theirs` is a point of low order (RFC 7748 §6.1).
    except ValueError as error:
        raise PeerError("handshake with a public key of low order: the shared secret would be zero") from error


def _new_pair(rng: Entropy) -> _Pair:
    return _make_pair(random_bytes(rng, KEY_BYTES))


@functools.lru_cache(maxsize=8)
def _pair(private: bytes) -> _Pair:
    """Return the pair of a static key. Cached, because the slave needs its own for every HELLO."""
    _check_length(private, "private key")
    return _make_pair(private)


def _make_pair(private: bytes) -> _Pair:
    key = X25519PrivateKey.from_private_bytes(private)
    return _Pair(key, key.public_key().public_bytes_raw())


def _check_length(key: bytes, name: str) -> None:
    if len(key) != KEY_BYTES:
        raise SettingsError(f"{name} of {len(key)} bytes; it has {KEY_BYTES}")


def _check_message(message: bytes, least: int) -> None:
    if len(message) < least:
        raise PeerError(f"handshake message of {len(message)} bytes; it has at least {least}")
