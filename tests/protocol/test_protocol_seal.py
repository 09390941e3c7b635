"""Sealed datagrams: golden ones, what opens, what is refused, and how the keys follow the sequence numbers."""

import json
import struct
from pathlib import Path

import msgpack
import pytest
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import PeerError
from hapticnet.protocol.handshake import hello_mac
from hapticnet.protocol.messages import HELLO_BYTES
from hapticnet.protocol.noise import Initiator, Responder
from hapticnet.protocol.seal import EPOCH_BITS, LAST_SEQUENCE, TAG_BYTES, Seal
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES, SEALED, Datagram, Kind
from tests.vectors import make_sealed

ONE = bytes(range(32))
OTHER = bytes(range(32, 64))
SESSION = 0xDEADBEEF
EPOCH = 1 << EPOCH_BITS
BODY = msgpack.packb([1, 2, 3])

bodies = st.binary(max_size=300)
uint32 = st.integers(0, 2**32 - 1)
early = st.integers(0, 2 * EPOCH - 1)
"""Sequence numbers that a receiver accepts first."""


def ends():
    """Return the master's end and the slave's."""
    return Seal(ONE, OTHER), Seal(OTHER, ONE)


def frame(data):
    """Return the frame of a datagram; PeerError if it has none, whichever version it claims."""
    try:
        version, kind, session, sequence, body = msgpack.unpackb(data, use_list=False)
        assert type(body) is bytes
        assert all(type(number) is int for number in (version, kind, session, sequence))
        assert 0 <= sequence < 2**32
    except (ValueError, TypeError, AssertionError) as error:
        raise PeerError("no frame") from error
    return Datagram(version, kind, session, sequence, body)


def open_(end, data):
    return end.open(data, frame(data))


def refuses(end, data):
    try:
        open_(end, data)
    except PeerError:
        return True
    return False


def key_of_epoch(key, epoch):
    """Noise revision 34, §4.2: REKEY, on bare keys."""
    for _ in range(epoch):
        key = ChaCha20Poly1305(key).encrypt(bytes(4) + b"\xff" * 8, bytes(32), b"")[:32]
    return key


@given(kind=st.sampled_from(Kind), session=uint32, sequence=early, body=bodies)
def test_what_one_end_seals_the_other_opens(kind, session, sequence, body):
    master, slave = ends()
    data = master.pack(kind, session, sequence, body)
    assert frame(data)[:4] == (SEALED, kind, session, sequence)
    assert open_(slave, data) == body
    answer = slave.pack(kind, session, sequence, body)
    assert open_(master, answer) == body
    assert answer != data


@given(kind=st.sampled_from(Kind), session=uint32, sequence=early, body=bodies)
def test_a_sealed_datagram_is_what_the_document_says(kind, session, sequence, body):
    """Computed here from the document: the shortest msgpack, and the seal of RFC 8439 over it."""
    data = Seal(ONE, OTHER).pack(kind, session, sequence, body)
    head = b"\x95" + b"".join(msgpack.packb(number) for number in (2, int(kind), session, sequence))
    cipher = ChaCha20Poly1305(key_of_epoch(ONE, sequence >> 20))
    sealed = cipher.encrypt(struct.pack("<4xQ", sequence), body, head)
    assert data == head + msgpack.packb(sealed)
    assert data == msgpack.packb([2, int(kind), session, sequence, sealed])
    assert len(sealed) == len(body) + TAG_BYTES


@pytest.mark.parametrize("length", [0, 240])
def test_every_flipped_bit_is_refused(length):
    master, slave = ends()
    data = master.pack(Kind.POSITION, SESSION, 70_000, bytes(length))
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        assert refuses(slave, bytes(changed)), f"bit {bit}"
    assert open_(slave, data) == bytes(length)


@given(data=st.data(), sequence=early, body=bodies)
def test_a_frame_that_says_something_else_is_refused(data, sequence, body):
    master, slave = ends()
    fields = list(frame(master.pack(Kind.FORCE, SESSION, sequence, body)))
    place = data.draw(st.integers(0, 3))
    fields[place] = data.draw(uint32.filter(lambda number: number != fields[place]))
    assert refuses(slave, msgpack.packb(fields))


@given(sequence=st.integers(0, 127), body=bodies)
def test_a_longer_msgpack_of_the_same_values_is_refused(sequence, body):
    """Only one string of bytes is a given datagram, so that nothing outside the seal can vary."""
    master, slave = ends()
    data = master.pack(Kind.FORCE, SESSION, sequence, body)
    sealed = frame(data).body
    head = data[: -len(msgpack.packb(sealed))]
    longer = [
        b"\xdc\x00\x05" + data[1:],
        head[:-1] + b"\xcc" + bytes([sequence]) + msgpack.packb(sealed),
        head[:-1] + b"\xce" + sequence.to_bytes(4, "big") + msgpack.packb(sealed),
        head + b"\xc6" + len(sealed).to_bytes(4, "big") + sealed,
    ]
    if len(sealed) < 256:
        longer.append(head + b"\xc5" + len(sealed).to_bytes(2, "big") + sealed)
    for other in longer:
        assert frame(other)[:] == frame(data)
        assert refuses(slave, other)
    assert open_(slave, data) == body


@given(body=st.binary(max_size=40), sequence=uint32)
def test_what_was_never_sealed_is_refused(body, sequence):
    master, _ = ends()
    assert refuses(master, msgpack.packb([2, int(Kind.FORCE), SESSION, sequence, body]))
    assert refuses(master, msgpack.packb([1, int(Kind.FORCE), SESSION, sequence, body]))


def test_a_datagram_sent_back_to_its_sender_is_refused():
    master, _ = ends()
    assert refuses(master, master.pack(Kind.POSITION, SESSION, 5, BODY))


def test_a_number_is_sealed_once():
    master, _ = ends()
    master.pack(Kind.POSITION, SESSION, 5, BODY)
    for sequence in (5, 4, 0, -1):
        with pytest.raises(ValueError, match="after 5"):
            master.pack(Kind.POSITION, SESSION, sequence, BODY)
    master.pack(Kind.POSITION, SESSION, 6, BODY)


def test_numbers_do_not_wrap():
    master = Seal(ONE, OTHER)
    for sequence in (LAST_SEQUENCE, LAST_SEQUENCE + 1, 2**32 - 1):
        master.pack(Kind.CLOSE, SESSION, sequence, BODY)
    for sequence in (2**32, 0):
        with pytest.raises(ValueError, match="used once, up to 4294967295"):
            master.pack(Kind.CLOSE, SESSION, sequence, BODY)


def test_the_longest_body_fills_a_datagram():
    master, slave = ends()
    longest = bytes(MAX_DATAGRAM_BYTES - TAG_BYTES - 16)
    data = master.pack(Kind.FORCE, SESSION, 70_000, longest)
    assert len(data) == MAX_DATAGRAM_BYTES
    assert open_(slave, data) == longest


def test_the_keys_change_with_the_epoch():
    master, slave = ends()
    for sequence in (0, EPOCH - 1, EPOCH, EPOCH + 1, 2 * EPOCH - 1, 2 * EPOCH, 3 * EPOCH + 7):
        data = master.pack(Kind.POSITION, SESSION, sequence, BODY)
        cipher = ChaCha20Poly1305(key_of_epoch(ONE, sequence // EPOCH))
        sealed = frame(data).body
        assert cipher.decrypt(struct.pack("<4xQ", sequence), sealed, data[: -2 - len(sealed)]) == BODY
        assert open_(slave, data) == BODY


def test_the_directions_change_keys_on_their_own():
    master, slave = ends()
    assert open_(slave, master.pack(Kind.POSITION, SESSION, EPOCH, BODY)) == BODY
    assert open_(master, slave.pack(Kind.FORCE, SESSION, 3, BODY)) == BODY


def test_a_whole_epoch_lost_ends_what_the_receiver_can_follow():
    master, slave = ends()
    assert refuses(slave, master.pack(Kind.POSITION, SESSION, 2 * EPOCH, BODY))


def test_late_datagrams_open_until_the_epoch_after_the_next():
    master, slave = ends()
    late = [master.pack(Kind.POSITION, SESSION, sequence, BODY) for sequence in range(EPOCH - 3, EPOCH)]
    first, *next_epoch = (master.pack(Kind.POSITION, SESSION, sequence, BODY) for sequence in (EPOCH, 2 * EPOCH - 1))
    assert open_(slave, first) == BODY
    assert open_(slave, late[0]) == BODY
    assert open_(slave, next_epoch[0]) == BODY
    assert open_(slave, late[1]) == BODY
    assert open_(slave, master.pack(Kind.POSITION, SESSION, 2 * EPOCH, BODY)) == BODY
    assert open_(slave, next_epoch[0]) == BODY
    assert refuses(slave, late[2])


@given(epochs=st.lists(st.integers(0, 4095), max_size=20), received=st.integers(0, 3))
def test_forged_datagrams_move_no_key(epochs, received):
    """Whatever epoch a forged datagram claims, the true ones of the current, last and next epoch still open."""
    master, slave = ends()
    for epoch in range(received):
        open_(slave, master.pack(Kind.POSITION, SESSION, epoch * EPOCH + 1, BODY))
    last, current = (
        master.pack(Kind.POSITION, SESSION, max(0, received - 1) * EPOCH + 5, BODY),
        master.pack(Kind.POSITION, SESSION, received * EPOCH + 6, BODY),
    )
    for epoch in epochs:
        forged = msgpack.packb([2, int(Kind.POSITION), SESSION, epoch * EPOCH + 9, bytes(40)])
        assert refuses(slave, forged)
    assert open_(slave, current) == BODY
    for epoch in epochs:
        forged = msgpack.packb([2, int(Kind.POSITION), SESSION, epoch * EPOCH + 9, bytes(40)])
        assert refuses(slave, forged)
    assert open_(slave, last) == BODY
    assert open_(slave, master.pack(Kind.POSITION, SESSION, (received + 1) * EPOCH, BODY)) == BODY


@given(steps=st.lists(st.integers(1, EPOCH // 2), min_size=1, max_size=12), order=st.randoms(use_true_random=False))
def test_reordering_within_half_an_epoch_loses_nothing(steps, order):
    master, slave = ends()
    sequence, sent = 0, []
    for step in steps:
        sequence += step
        sent.append((sequence, master.pack(Kind.POSITION, SESSION, sequence, sequence.to_bytes(4, "big"))))
    late = order.randint(0, EPOCH // 4)
    arriving = sorted(sent, key=lambda item: item[0] + order.randint(0, late))
    for number, data in arriving:
        assert open_(slave, data) == number.to_bytes(4, "big")


VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "sealed.json").read_text())
KEYS = {name: bytes.fromhex(key) for name, key in VECTORS["keys"].items() if isinstance(key, str)}
NONCE = VECTORS["nonce"]
HANDSHAKE = {each["name"]: each for each in VECTORS["datagrams"] if each["kind"] in ("HELLO", "COOKIE", "WELCOME")}
GOLDEN = [each for each in VECTORS["datagrams"] if each["name"] not in HANDSHAKE]
PROLOGUE = b"hapticnet 2" + NONCE.to_bytes(4, "big") + bytes(4)


class Once:
    """Entropy that returns one key, as the eight words it is drawn in."""

    def __init__(self, key):
        self._words = [int.from_bytes(key[i : i + 4], "big") for i in range(0, 32, 4)]

    def integers(self, _low, _high, /):
        return self._words.pop(0)


def raw(value):
    """Return fields as they are, of fields as the file holds them."""
    if isinstance(value, dict) and list(value) == ["hex"]:
        return bytes.fromhex(value["hex"])
    return [raw(each) for each in value] if isinstance(value, list) else value


def keys_of_epoch(epoch):
    return bytes.fromhex(VECTORS["keys"]["to_slave"][epoch]), bytes.fromhex(VECTORS["keys"]["to_master"][epoch])


def golden_ends():
    to_slave, to_master = keys_of_epoch(0)
    return {"master": Seal(to_slave, to_master), "slave": Seal(to_master, to_slave)}


def datagram(vector):
    version, kind, session, sequence, body = msgpack.unpackb(bytes.fromhex(vector["hex"]), use_list=False)
    assert (version, Kind(kind).name, session, sequence) == (2, vector["kind"], vector["session"], vector["sequence"])
    return Datagram(version, Kind(kind), session, sequence, body)


def initiator():
    return Initiator(
        KEYS["master_private"], KEYS["slave_public"], KEYS["psk"], PROLOGUE, Once(KEYS["master_ephemeral"])
    )


def test_the_file_is_what_the_script_writes():
    keys, entries = make_sealed.session()
    assert entries == VECTORS["datagrams"]
    assert [list(each) for each in zip(*keys, strict=True)] == [
        [bytes.fromhex(key) for key in VECTORS["keys"][name]] for name in ("to_slave", "to_master")
    ]


def test_the_file_shows_every_kind_of_a_sealed_session():
    kinds = {vector["kind"] for vector in VECTORS["datagrams"]}
    assert kinds == {kind.name for kind in Kind} - {"REFUSE", "RESET"} | {"COOKIE"}


@pytest.mark.parametrize("name", ["hello without a cookie", "hello with the cookie"])
def test_a_golden_hello_is_written_and_read_to_the_byte(name):
    vector = HANDSHAKE[name]
    nonce, cookie, noise1, mac1 = raw(vector["fields"])
    request = msgpack.packb(raw(vector["payload"]))
    assert nonce == NONCE
    assert initiator().write(request) == noise1
    assert hello_mac(KEYS["slave_public"], NONCE, vector["sequence"], noise1) == mac1
    responder = Responder(KEYS["slave_private"], PROLOGUE, Once(KEYS["slave_ephemeral"]))
    assert responder.read(noise1) == (KEYS["master_public"], request)
    data = bytes.fromhex(vector["hex"])
    assert len(data) >= HELLO_BYTES
    assert msgpack.unpackb(datagram(vector).body)[:4] == [nonce, cookie, noise1, mac1]


@pytest.mark.parametrize("name", ["welcome", "refusal"])
def test_a_golden_welcome_is_written_and_read_to_the_byte(name):
    vector = HANDSHAKE[name]
    nonce, noise2 = raw(vector["fields"])
    payload = msgpack.packb(raw(vector["payload"]))
    master = initiator()
    responder = Responder(KEYS["slave_private"], PROLOGUE, Once(KEYS["slave_ephemeral"]))
    responder.read(master.write(msgpack.packb(raw(HANDSHAKE["hello with the cookie"]["payload"]))))
    assert responder.write(payload, KEYS["psk"]) == (noise2, keys_of_epoch(0))
    assert master.read(noise2) == (payload, keys_of_epoch(0))
    assert msgpack.unpackb(datagram(vector).body) == [nonce, noise2]


@pytest.mark.parametrize("sender", ["master", "slave"])
def test_golden_data_are_written_to_the_byte(sender):
    end = golden_ends()[sender]
    sent = [vector for vector in GOLDEN if vector["from"] == sender]
    assert {vector["sequence"] >> EPOCH_BITS for vector in sent} == {0, 1}
    for vector in sent:
        body = msgpack.packb(raw(vector["fields"]))
        data = end.pack(Kind[vector["kind"]], vector["session"], vector["sequence"], body)
        assert data.hex() == vector["hex"]


@pytest.mark.parametrize(("sender", "receiver"), [("master", "slave"), ("slave", "master")])
def test_golden_data_are_opened(sender, receiver):
    end = golden_ends()[receiver]
    for vector in GOLDEN:
        if vector["from"] == sender:
            body = end.open(bytes.fromhex(vector["hex"]), datagram(vector))
            assert msgpack.unpackb(body) == raw(vector["fields"])
