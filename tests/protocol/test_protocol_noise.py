"""The Noise handshake: published vectors, another implementation as the peer, and every way to refuse a message."""

import json
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from hypothesis import given, settings
from hypothesis import strategies as st
from noise.connection import Keypair, NoiseConnection

from hapticnet.errors import PeerError, SettingsError
from hapticnet.protocol.keys import NO_PSK
from hapticnet.protocol.noise import MESSAGE_1_BYTES, MESSAGE_2_BYTES, NAME, Initiator, Responder, public_key

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "noise.json").read_text())["handshakes"]
PROLOGUE = b"a prologue"
PSK = bytes(range(100, 132))
MASTER = bytes(range(32))
SLAVE = bytes(range(1, 33))

LOW_ORDER = [
    bytes(32),
    (1).to_bytes(32, "little"),
    bytes.fromhex("e0eb7a7c3b41b8ae1656e3faf19fc46ada098deb9c32b1fd866205165f49b800"),
    bytes.fromhex("5f9c95bca3508c24b1d0b1559c83ef5b04445cc4581c8e86d8224eddd09f1157"),
    (2**255 - 20).to_bytes(32, "little"),
    (2**255 - 19).to_bytes(32, "little"),
    (2**255 - 18).to_bytes(32, "little"),
]
"""The points of order 1, 2, 4 and 8 (https://cr.yp.to/ecdh.html, "validate"), as 255-bit numbers."""


class FixedEntropy:
    """Returns given bytes once, as the words that `random_bytes` asks for."""

    def __init__(self, data):
        self._words = [int.from_bytes(data[i : i + 4], "big") for i in range(0, len(data), 4)]

    def integers(self, low, high, /):
        assert (low, high) == (0, 1 << 32)
        return self._words.pop(0)


def entropy(seed=0):
    return np.random.default_rng(seed)


def ends(*, master=MASTER, slave=SLAVE, known=None, psk=PSK, prologues=(PROLOGUE, PROLOGUE), seed=0):
    """Return an initiator and a responder that share everything unless told otherwise."""
    rng = entropy(seed)
    return (Initiator(master, known or public_key(slave), psk, prologues[0], rng), Responder(slave, prologues[1], rng))


def shake_hands(initiator, responder, request=b"request", grant=b"grant", psk=PSK):
    assert responder.read(initiator.write(request)) == (public_key(MASTER), request)
    message, theirs = responder.write(grant, psk)
    payload, ours = initiator.read(message)
    assert payload == grant
    assert ours == theirs
    return ours


def other_implementation(*, initiator, static, remote=None, psk=PSK):
    """Return an end of PyPI's noiseprotocol."""
    end = NoiseConnection.from_name(NAME)
    (end.set_as_initiator if initiator else end.set_as_responder)()
    end.set_prologue(PROLOGUE)
    end.set_psks(psk)
    end.set_keypair_from_private_bytes(Keypair.STATIC, static)
    if remote:
        end.set_keypair_from_public_bytes(Keypair.REMOTE_STATIC, remote)
    end.start_handshake()
    return end


def nonce(number):
    return bytes(4) + number.to_bytes(8, "little")


def flips(data):
    """Yield `data` with each single bit flipped."""
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["source"].split(",")[0].rpartition("/")[2])
def test_published_vectors(vector):
    assert vector["name"].encode() == NAME
    texts = {name: value for name, value in vector.items() if name not in ("name", "source", "messages")}
    key = {name: bytes.fromhex(value) for name, value in texts.items()}
    initiator = Initiator(
        key["init_static"], key["resp_public"], key["psk"], key["prologue"], FixedEntropy(key["init_ephemeral"])
    )
    responder = Responder(key["resp_static"], key["prologue"], FixedEntropy(key["resp_ephemeral"]))
    (first, second, *transport) = (
        (bytes.fromhex(message["payload"]), bytes.fromhex(message["ciphertext"])) for message in vector["messages"]
    )
    assert public_key(key["resp_static"]) == key["resp_public"]
    assert initiator.write(first[0]) == first[1]
    assert responder.read(first[1]) == (public_key(key["init_static"]), first[0])
    message, theirs = responder.write(second[0], key["psk"])
    assert message == second[1]
    assert initiator.read(message) == (second[0], theirs)
    assert transport
    for number, (payload, ciphertext) in enumerate(transport):
        sender = theirs[number % 2]
        assert ChaCha20Poly1305(sender).encrypt(nonce(number // 2), payload, b"") == ciphertext


@given(request=st.binary(max_size=300), grant=st.binary(max_size=300), psk=st.binary(min_size=32, max_size=32))
@settings(max_examples=20, deadline=None)
def test_another_implementation_answers(request, grant, psk):
    initiator, _ = ends(psk=psk)
    peer = other_implementation(initiator=False, static=SLAVE, psk=psk)
    message = initiator.write(request)
    assert len(message) == MESSAGE_1_BYTES + len(request)
    assert peer.read_message(message) == request
    answer = bytes(peer.write_message(grant))
    assert len(answer) == MESSAGE_2_BYTES + len(grant)
    payload, keys = initiator.read(answer)
    assert payload == grant
    assert peer.decrypt(ChaCha20Poly1305(keys.to_responder).encrypt(nonce(0), b"position", b"")) == b"position"
    assert ChaCha20Poly1305(keys.to_initiator).decrypt(nonce(0), bytes(peer.encrypt(b"force")), b"") == b"force"


@given(request=st.binary(max_size=300), grant=st.binary(max_size=300), psk=st.binary(min_size=32, max_size=32))
@settings(max_examples=20, deadline=None)
def test_another_implementation_asks(request, grant, psk):
    _, responder = ends()
    peer = other_implementation(initiator=True, static=MASTER, remote=public_key(SLAVE), psk=psk)
    assert responder.read(bytes(peer.write_message(request))) == (public_key(MASTER), request)
    message, keys = responder.write(grant, psk)
    assert peer.read_message(message) == grant
    assert ChaCha20Poly1305(keys.to_responder).decrypt(nonce(0), bytes(peer.encrypt(b"position")), b"") == b"position"
    assert peer.decrypt(ChaCha20Poly1305(keys.to_initiator).encrypt(nonce(0), b"force", b"")) == b"force"


def test_the_same_seed_gives_the_same_handshake_and_another_seed_another():
    keys = shake_hands(*ends(seed=1))
    assert keys == shake_hands(*ends(seed=1))
    assert keys.to_responder != keys.to_initiator
    assert {len(key) for key in keys} == {32}
    assert shake_hands(*ends(seed=1)) != shake_hands(*ends(seed=2))


def test_every_handshake_has_fresh_ephemeral_keys():
    initiator, responder = ends()
    first, second = initiator.write(b""), initiator.write(b"")
    assert first[:32] != second[:32]
    responder.read(second)
    (one, keys), (two, others) = responder.write(b"", PSK), responder.write(b"", PSK)
    assert one[:32] != two[:32]
    assert keys != others


def test_a_message_with_any_bit_changed_is_refused_and_the_true_one_still_opens():
    initiator, responder = ends()
    first = initiator.write(b"request")
    for changed in flips(first):
        with pytest.raises(PeerError):
            responder.read(changed)
    assert responder.read(first) == (public_key(MASTER), b"request")
    for later in (bytes(range(MESSAGE_1_BYTES)), changed):  # and it forgets nothing of the true one
        with pytest.raises(PeerError):
            responder.read(later)
    message, keys = responder.write(b"grant", PSK)
    for changed in flips(message):
        with pytest.raises(PeerError):
            initiator.read(changed)
    assert initiator.read(message) == (b"grant", keys)


@given(message=st.binary(max_size=300))
def test_garbage_is_a_peer_error(message):
    initiator, responder = ends()
    initiator.write(b"")
    for end in (initiator, responder):
        with pytest.raises(PeerError):
            end.read(message)


def test_keys_do_not_show_in_what_is_printed():
    initiator, responder = ends()
    keys = shake_hands(initiator, responder)
    assert repr(keys) == "TransportKeys(…)"
    assert keys.to_responder.hex() not in repr((keys, initiator, responder))


@pytest.mark.parametrize("different", ["slave", "prologue", "pre-shared key"])
def test_an_end_that_does_not_share_everything_is_refused(different):
    initiator, responder = ends(prologues=(PROLOGUE, b"hapticnet 3" if different == "prologue" else PROLOGUE))
    if different == "slave":
        _, responder = ends(slave=bytes(range(50, 82)))
    first = initiator.write(b"")
    if different != "pre-shared key":
        with pytest.raises(PeerError, match="does not open"):
            responder.read(first)
        return
    responder.read(first)
    with pytest.raises(PeerError, match="does not open"):
        initiator.read(responder.write(b"", NO_PSK)[0])


def test_an_impostor_without_the_slaves_private_key_cannot_answer():
    """Not even a thief of the master's key, who can let the master ask the impostor."""
    initiator, _ = ends()
    impostor = Responder(bytes(range(50, 82)), PROLOGUE, entropy(9))
    impostor.read(Initiator(MASTER, public_key(bytes(range(50, 82))), PSK, PROLOGUE, entropy(8)).write(b""))
    initiator.write(b"")
    message, _ = impostor.write(b"", PSK)
    with pytest.raises(PeerError, match="does not open"):
        initiator.read(message)


def test_an_answer_to_an_earlier_message_is_refused():
    initiator, responder = ends()
    responder.read(initiator.write(b""))
    stale, _ = responder.write(b"", PSK)
    responder.read(initiator.write(b""))
    message, keys = responder.write(b"", PSK)
    with pytest.raises(PeerError):
        initiator.read(stale)
    assert initiator.read(message) == (b"", keys)


@pytest.mark.parametrize("point", LOW_ORDER, ids=lambda point: point.hex()[:8])
@pytest.mark.parametrize("top_bit", [0, 0x80], ids=["", "top bit set"])
def test_points_of_low_order_are_refused(point, top_bit):
    point = point[:31] + bytes([point[31] | top_bit])
    initiator, responder = ends()
    message = initiator.write(b"")
    with pytest.raises(PeerError, match="low order"):
        responder.read(point + message[32:])
    with pytest.raises(PeerError, match="low order"):
        initiator.read(point + bytes(16))
    with pytest.raises(SettingsError, match="low order"):
        Initiator(MASTER, point, PSK, PROLOGUE, entropy())


def test_a_static_key_of_low_order_inside_a_message_is_refused():
    """A peer that breaks the rules can seal any 32 bytes as its static key."""
    peer = other_implementation(initiator=True, static=MASTER, remote=public_key(SLAVE))
    peer.noise_protocol.handshake_state.s.public_bytes = bytes(32)
    with pytest.raises(PeerError, match="low order"):
        ends()[1].read(bytes(peer.write_message(b"")))


@pytest.mark.parametrize("length", [0, 31, 33])
def test_keys_of_wrong_length_are_the_callers_fault(length):
    key, rng = bytes(length), entropy()
    initiator, responder = ends()
    responder.read(initiator.write(b""))
    for call in (
        lambda: public_key(key),
        lambda: Initiator(key, public_key(SLAVE), PSK, PROLOGUE, rng),
        lambda: Initiator(MASTER, key, PSK, PROLOGUE, rng),
        lambda: Initiator(MASTER, public_key(SLAVE), key, PROLOGUE, rng),
        lambda: Responder(key, PROLOGUE, rng),
        lambda: responder.write(b"", key),
    ):
        with pytest.raises(SettingsError, match=f"{length} bytes; it has 32"):
            call()


def test_messages_out_of_order_are_the_callers_fault():
    initiator, responder = ends()
    with pytest.raises(RuntimeError, match="first message"):
        initiator.read(bytes(MESSAGE_2_BYTES))
    with pytest.raises(RuntimeError, match="first message"):
        responder.write(b"", PSK)
