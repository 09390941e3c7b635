"""Write tests/vectors/sealed.json, one session with all its keys: ``python -m tests.vectors.make_sealed``.

The datagrams come from the peer in `tests.protocol.sealed_peer`, which imports nothing of hapticnet.
"""

import json
from pathlib import Path

import msgpack
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from tests.protocol.sealed_peer import (
    CLOSE,
    FORCE,
    HELLO,
    KEEPALIVE,
    KINDS,
    NOTICE,
    POSITION,
    VIBRATION,
    Master,
    Slave,
    unpack,
)
from tests.vectors import make_protocol
from tests.vectors.make_protocol import COOKIE_VALUE, GRANT, NONCE, plain

FILE = Path(__file__).with_name("sealed.json")

NOTE = (
    "One sealed session, both directions. Keys are hex. Byte strings in fields are {'hex': ...}. 'fields' are those of"
    " the body, without HELLO's padding, or of the plaintext where the body is sealed; 'payload' is what the Noise"
    " message in a HELLO or WELCOME carries. The keys 'to_slave' and 'to_master' are those of epochs 0 and 1."
)

EPOCH = 1 << 20
PAYLOAD = b"\x00" + bytes(8)
REQUEST = ["deadband", {"step_n": 0.001}, *make_protocol.REQUEST[2:]]
REFUSAL = [0, "every session is taken", 5]
FROM_MASTER = [
    ("position", POSITION, 1, [123_456, None, PAYLOAD]),
    ("position that acknowledges", POSITION, 2, [124_456, 1, PAYLOAD]),
    ("last position of epoch 0", POSITION, EPOCH - 1, [125_456, 70_000, PAYLOAD]),
    ("first position of epoch 1", POSITION, EPOCH, [126_456, 70_000, PAYLOAD]),
    ("close by the master", CLOSE, EPOCH + 1, ["bye", 0]),
]
FROM_SLAVE = [
    ("force", FORCE, 1, [123_456, PAYLOAD]),
    ("keepalive", KEEPALIVE, 2, [124_456, 1]),
    ("force with a longer head", FORCE, 70_000, [125_456, bytes(range(240))]),
    ("notice", NOTICE, 70_001, ["this slave is about to stop", 8]),
    ("vibration", VIBRATION, 70_002, [116_456, bytes(range(6))]),
    ("first keepalive of epoch 1", KEEPALIVE, EPOCH, [126_456, 70_000]),
    ("close by the slave", CLOSE, EPOCH + 1, ["the master closed", 0]),
]


def private(first):
    """Return a private key that anyone can see is not a secret."""
    return bytes(range(first, first + 32))


KEYS = {
    "master_private": private(0x01),
    "slave_private": private(0x21),
    "master_ephemeral": private(0x41),
    "slave_ephemeral": private(0x61),
    "psk": private(0x81),
}


def public(key):
    return X25519PrivateKey.from_private_bytes(key).public_key().public_bytes_raw()


def shake_hands(grant):
    """Return both ends, with the fixed keys, and the datagrams of their handshake: HELLO, COOKIE, HELLO, WELCOME."""
    slave_public = public(KEYS["slave_private"])
    psk = KEYS["psk"]
    master = Master(
        KEYS["master_private"], slave_public, REQUEST, nonce=NONCE, psk=psk, ephemeral=KEYS["master_ephemeral"]
    )
    slave = Slave(
        KEYS["slave_private"], slave_public, grant, cookie=COOKIE_VALUE, psk=psk, ephemeral=KEYS["slave_ephemeral"]
    )
    hello = master.hello()
    _, _, cookie = slave.receive(hello)
    master.receive(cookie)
    proved = master.hello()
    _, _, welcome = slave.receive(proved)
    master.receive(welcome)
    return master, slave, (hello, cookie, proved, welcome)


def entry(name, sender, data, fields=None, payload=None):
    """Return a datagram as the file holds it; `fields` where they cannot be read from the datagram."""
    kind, session, sequence, body = unpack(data)
    if fields is None:
        fields = msgpack.unpackb(body, use_list=False)
        fields = fields[:-1] if kind == HELLO else fields
    extra = {} if payload is None else {"payload": plain(payload)}
    place = {"name": name, "from": sender, "kind": KINDS[kind], "session": session, "sequence": sequence}
    return {**place, "fields": plain(fields), **extra, "hex": data.hex()}


def session():
    """Return the keys of the session, and its datagrams."""
    master, slave, (hello, cookie, proved, welcome) = shake_hands(GRANT)
    keys = [(bytes(master.keys[0]), bytes(master.keys[1]))]
    entries = [
        entry("hello without a cookie", "master", hello, payload=REQUEST),
        entry("cookie", "slave", cookie),
        entry("hello with the cookie", "master", proved, payload=REQUEST),
        entry("welcome", "slave", welcome, payload=GRANT),
    ]
    for sender, receiver, messages in (("master", slave, FROM_MASTER), ("slave", master, FROM_SLAVE)):
        end = master if sender == "master" else slave
        for name, kind, sequence, fields in messages:
            data = end.send(kind, fields, sequence=sequence)
            assert receiver.receive(data)[1] == tuple(fields)
            entries.append(entry(name, sender, data, fields))
    keys.append((bytes(master.keys[0]), bytes(master.keys[1])))
    *_, refusal = shake_hands(REFUSAL)[2]
    entries.append(entry("refusal", "slave", refusal, payload=REFUSAL))
    return keys, entries


def main():
    keys, entries = session()
    document = {
        "protocol_version": 2,
        "note": NOTE,
        "nonce": NONCE,
        "keys": {
            **{name: key.hex() for name, key in KEYS.items()},
            "master_public": public(KEYS["master_private"]).hex(),
            "slave_public": public(KEYS["slave_private"]).hex(),
            "to_slave": [to_slave.hex() for to_slave, _ in keys],
            "to_master": [to_master.hex() for _, to_master in keys],
        },
        "datagrams": entries,
    }
    FILE.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
