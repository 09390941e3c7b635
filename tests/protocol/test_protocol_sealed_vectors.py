"""Golden sealed datagrams: made by another implementation, read and written to the byte by this one."""

import json
from pathlib import Path

import msgpack
import pytest
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from hapticnet.protocol.handshake import hello_mac
from hapticnet.protocol.messages import HELLO_BYTES
from hapticnet.protocol.noise import Initiator, Responder, public_key
from hapticnet.protocol.seal import EPOCH_BITS, Seal
from hapticnet.protocol.wire import Datagram, Kind
from tests.vectors import make_sealed

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "sealed.json").read_text())
KEYS = {name: bytes.fromhex(key) for name, key in VECTORS["keys"].items() if isinstance(key, str)}
NONCE = VECTORS["nonce"]
HANDSHAKE = {each["name"]: each for each in VECTORS["datagrams"] if each["kind"] in ("HELLO", "COOKIE", "WELCOME")}
SEALED = [each for each in VECTORS["datagrams"] if each["name"] not in HANDSHAKE]
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


def ends():
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


def test_the_public_keys_belong_to_the_private_ones():
    for side in ("master", "slave"):
        assert public_key(KEYS[f"{side}_private"]) == KEYS[f"{side}_public"]


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
    end = ends()[sender]
    sent = [vector for vector in SEALED if vector["from"] == sender]
    assert {vector["sequence"] >> EPOCH_BITS for vector in sent} == {0, 1}
    for vector in sent:
        body = msgpack.packb(raw(vector["fields"]))
        data = end.pack(Kind[vector["kind"]], vector["session"], vector["sequence"], body)
        assert data.hex() == vector["hex"]


@pytest.mark.parametrize(("sender", "receiver"), [("master", "slave"), ("slave", "master")])
def test_golden_data_are_opened(sender, receiver):
    end = ends()[receiver]
    for vector in SEALED:
        if vector["from"] == sender:
            body = end.open(bytes.fromhex(vector["hex"]), datagram(vector))
            assert msgpack.unpackb(body) == raw(vector["fields"])


def test_the_keys_of_epoch_1_are_those_of_the_ratchet():
    for before, after in zip(keys_of_epoch(0), keys_of_epoch(1), strict=True):
        assert ChaCha20Poly1305(before).encrypt(bytes(4) + b"\xff" * 8, bytes(32), b"")[:32] == after
