"""Both ends of a sealed session, written from docs/refer/protocol.md on PyPI's noiseprotocol and msgpack alone.

Nothing of hapticnet is imported: what these two understand, and what they are understood by, is what the document says.
They know one session, believe every sequence number that opens, and keep no timers.
"""

import hashlib
import warnings

import msgpack
from noise.connection import Keypair, NoiseConnection

NAME = b"Noise_IKpsk2_25519_ChaChaPoly_BLAKE2s"
NAMES = ["HELLO", "WELCOME", "REFUSE", "POSITION", "FORCE", "KEEPALIVE", "CLOSE", "RESET", "COOKIE", "NOTICE"]
NAMES.append("VIBRATION")
HELLO, WELCOME, REFUSE, POSITION, FORCE, KEEPALIVE, CLOSE, RESET, COOKIE, NOTICE, VIBRATION = range(1, 12)
KINDS = dict(enumerate(NAMES, start=1))


def pack(kind, session, sequence, body):
    return msgpack.packb([2, kind, session, sequence, body])


def unpack(data):
    version, kind, session, sequence, body = msgpack.unpackb(data, use_list=False)
    assert version == 2
    return kind, session, sequence, body


def mac1(slave_public, nonce, sequence, noise1):
    key = hashlib.blake2s(b"hapticnet mac1" + slave_public).digest()
    said = nonce.to_bytes(4, "big") + sequence.to_bytes(4, "big") + noise1
    return hashlib.blake2s(said, digest_size=16, key=key).digest()


class Direction:
    """One direction of a session: Noise's CipherState, whose nonce is set and whose key changes by sequence number."""

    def __init__(self, state):
        self._state = state
        self._epoch = 0

    @property
    def key(self):
        """The key of the epoch reached."""
        return self._state.k

    def seal(self, kind, session, sequence, fields):
        head = b"\x95" + b"".join(msgpack.packb(number) for number in (2, kind, session, sequence))
        body = self._at(sequence).encrypt_with_ad(head, msgpack.packb(fields))
        return head + msgpack.packb(body)

    def open(self, data):
        """Return kind, session, sequence and fields of a datagram; InvalidTag if it was not sealed with this key."""
        kind, session, sequence, body = unpack(data)
        head = data[: -len(msgpack.packb(body))]
        fields = msgpack.unpackb(bytes(self._at(sequence).decrypt_with_ad(head, body)), use_list=False)
        return kind, session, sequence, fields

    def _at(self, sequence):
        while self._epoch < sequence >> 20:
            self._state.rekey()
            self._epoch += 1
        self._state.set_nonce(sequence)
        return self._state


def _noise(*, initiator, static, nonce, sequence, psk, remote=None, ephemeral=None):
    end = NoiseConnection.from_name(NAME)
    (end.set_as_initiator if initiator else end.set_as_responder)()
    end.set_prologue(b"hapticnet 2" + nonce.to_bytes(4, "big") + sequence.to_bytes(4, "big"))
    end.set_psks(psk)
    end.set_keypair_from_private_bytes(Keypair.STATIC, static)
    if remote is not None:
        end.set_keypair_from_public_bytes(Keypair.REMOTE_STATIC, remote)
    if ephemeral is not None:
        end.set_keypair_from_private_bytes(Keypair.EPHEMERAL, ephemeral)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="One of ephemeral keypairs is already set")
        end.start_handshake()
    return end


class Master:
    """The master's end. `request` are the fields of the request, `ephemeral` a private key for reproducible bytes."""

    def __init__(self, static, slave_public, request, *, nonce, sequence=0, psk=bytes(32), ephemeral=None):
        self._noise = _noise(
            initiator=True,
            static=static,
            nonce=nonce,
            sequence=sequence,
            psk=psk,
            remote=slave_public,
            ephemeral=ephemeral,
        )
        self._nonce, self._first, self._sequence = nonce, sequence, sequence
        self._noise1 = bytes(self._noise.write_message(msgpack.packb(request)))
        self._mac1 = mac1(slave_public, nonce, sequence, self._noise1)
        self.cookie = b""
        self.session = 0
        self.grant = None

    @property
    def keys(self):
        """The keys of the epochs reached: to the slave, and to the master."""
        return self._send.key, self._receive.key

    def hello(self):
        bare = pack(HELLO, 0, self._first, msgpack.packb([self._nonce, self.cookie, self._noise1, self._mac1, b""]))
        body = [self._nonce, self.cookie, self._noise1, self._mac1, bytes(max(0, 400 - len(bare)))]
        return pack(HELLO, 0, self._first, msgpack.packb(body))

    def receive(self, data):
        """Return kind and fields; takes the cookie of a COOKIE and the session of a WELCOME."""
        kind, session, _, body = unpack(data)
        if kind == COOKIE:
            nonce, self.cookie = fields = msgpack.unpackb(body, use_list=False)
            assert nonce == self._nonce
            return kind, fields
        if kind == WELCOME:
            nonce, noise2 = msgpack.unpackb(body, use_list=False)
            assert nonce == self._nonce
            fields = msgpack.unpackb(bytes(self._noise.read_message(noise2)), use_list=False)
            assert fields[0] == session
            self.session, self.grant = session, fields
            self._send = Direction(self._noise.noise_protocol.cipher_state_encrypt)
            self._receive = Direction(self._noise.noise_protocol.cipher_state_decrypt)
            return kind, fields
        kind, session, _, fields = self._receive.open(data)
        assert session == self.session
        return kind, fields

    def send(self, kind, fields, *, sequence=None):
        self._sequence = self._sequence + 1 if sequence is None else sequence
        return self._send.seal(kind, self.session, self._sequence, fields)


class Slave:
    """The slave's end; it asks for the given cookie and grants the given fields to whoever comes."""

    def __init__(self, static, public, grant, *, cookie=bytes(16), sequence=0, psk=bytes(32), ephemeral=None):
        self._static, self._public, self._psk, self._ephemeral = static, public, psk, ephemeral
        self._cookie = cookie
        self._sequence = sequence
        self.grant = grant
        self.session = grant[0]
        self.request = self.master_public = None

    def receive(self, data):
        """Return kind, fields, and the answer to a HELLO."""
        kind, session, sequence, body = unpack(data)
        if kind != HELLO:
            kind, session, _, fields = self._receive.open(data)
            assert session == self.session
            return kind, fields, None
        assert session == 0
        assert len(data) >= 400
        nonce, cookie, noise1, mac, _ = fields = msgpack.unpackb(body, use_list=False)
        assert mac == mac1(self._public, nonce, sequence, noise1)
        if cookie != self._cookie:
            return kind, fields, pack(COOKIE, 0, 0, msgpack.packb([nonce, self._cookie]))
        noise = _noise(
            initiator=False,
            static=self._static,
            nonce=nonce,
            sequence=sequence,
            psk=self._psk,
            ephemeral=self._ephemeral,
        )
        self.request = msgpack.unpackb(bytes(noise.read_message(noise1)), use_list=False)
        self.master_public = noise.noise_protocol.handshake_state.rs.public_bytes
        noise2 = bytes(noise.write_message(msgpack.packb(self.grant)))
        self._send = Direction(noise.noise_protocol.cipher_state_encrypt)
        self._receive = Direction(noise.noise_protocol.cipher_state_decrypt)
        return kind, fields, pack(WELCOME, self.session, self._sequence, msgpack.packb([nonce, noise2]))

    def send(self, kind, fields, *, sequence=None):
        self._sequence = self._sequence + 1 if sequence is None else sequence
        return self._send.seal(kind, self.session, self._sequence, fields)
