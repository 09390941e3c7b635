"""Both languages read, and refuse, the same damaged datagrams."""

import ctypes
import json
import random

import msgpack
import pytest

import peer
from conformance.damage import changed
from hapticnet.errors import PeerError
from hapticnet.protocol import messages
from hapticnet.protocol.wire import Kind, unpack

VECTORS = peer.HERE.parents[1] / "tests" / "vectors"
SEEDS = [
    bytes.fromhex(each["hex"])
    for name in ("protocol.json", "refused.json")
    for each in json.loads((VECTORS / name).read_text())["datagrams"]
    if len(each["hex"]) < 800 and each.get("outcome") != "dropped"
]
READERS = {
    Kind.WELCOME: lambda body: messages.unpack_grant(messages.unpack_welcome(body).grant),
    Kind.REFUSE: messages.unpack_refuse,
    Kind.POSITION: messages.unpack_position,
    Kind.FORCE: messages.unpack_force,
    Kind.KEEPALIVE: messages.unpack_keepalive,
    Kind.CLOSE: messages.unpack_close,
    Kind.RESET: lambda body: body,
    Kind.COOKIE: messages.unpack_cookie,
    Kind.NOTICE: messages.unpack_notice,
}


def damaged(chance, data):
    """Return a datagram, some of whose bytes were changed, left out or repeated."""
    frame = msgpack.unpackb(data) if chance.random() < 0.5 else None
    whole = frame is not None and type(frame) is list and len(frame) == 5 and type(frame[4]) is bytes
    part = changed(chance, frame[4] if whole else data)  # a body, or all of it
    return msgpack.packb([*frame[:4], part]) if whole else part


def read(data):
    """Return the kind of a datagram that hapticnet reads, or None."""
    try:
        datagram = unpack(data)
        if datagram.kind in READERS:
            READERS[datagram.kind](datagram.body)
    except PeerError:
        return None
    return datagram.kind


@pytest.mark.parametrize("seed", range(8))
def test_a_damaged_datagram_is_read_by_both_or_by_neither(lib, seed):
    chance, out, outcomes = random.Random(seed), ctypes.create_string_buffer(1200), {True: 0, False: 0}
    for _ in range(4000):
        try:
            data = damaged(chance, chance.choice(SEEDS))
        except ValueError:  # the seed was no msgpack
            continue
        kind = read(data)
        if kind in (Kind.HELLO, Kind.VIBRATION):
            continue  # the requests of vectors are compared elsewhere; a vibration is not read
        accepted = lib.shim_repack(data, ctypes.c_size_t(len(data)), out) > 0
        assert accepted == (kind is not None), data.hex()
        outcomes[accepted] += 1
    assert min(outcomes.values()) > 200
