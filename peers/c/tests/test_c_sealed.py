"""Sealed sessions of the C master: vectors, and the same bytes and forces as hapticnet's over the same network."""

import ctypes
import json
from dataclasses import replace

import msgpack
import pytest
from test_c_sessions import NETWORKS, Pair, in_c
from test_c_slave import Pair as SlavePair
from test_c_slave import Wall, position

import peer
from hapticnet.protocol.keys import MasterKey, PrivateKey
from hapticnet.protocol.messages import Code
from hapticnet.protocol.seal import LAST_SEQUENCE
from tests.peers import ENTRY, KEY, MASTER, OTHER_ENTRY, PSK, SLAVE

SEALED = json.loads((peer.HERE.parents[1] / "tests" / "vectors" / "sealed.json").read_text())
KEYS = {name: bytes.fromhex(key) for name, key in SEALED["keys"].items() if isinstance(key, str)}
SHARED = MasterKey(PrivateKey(MASTER.private, PSK), SLAVE.public)
SHARING = replace(ENTRY, psk=PSK)


def test_the_hellos_of_the_vectors_are_written_to_the_byte_and_their_welcome_opens(lib):
    ephemeral, request = KEYS["master_ephemeral"], SEALED["datagrams"][0]["payload"]
    drawn = [SEALED["nonce"], *(int.from_bytes(ephemeral[i : i + 4], "big") for i in range(0, 32, 4))]
    master = peer.Master(lib, iter(drawn).__next__, lambda _: (0.0,), parameters=request[1], name=request[7])
    assert master.seal(KEYS["master_private"], KEYS["slave_public"], KEYS["psk"])
    now_us = request[9]
    master.tick(now_us)
    for each in SEALED["datagrams"]:
        if each["from"] == "slave":
            master.receive_datagram(bytes.fromhex(each["hex"]), now_us)
        else:
            assert [data.hex() for data in master.datagrams_to_send()] == [each["hex"]]
        if each["kind"] == "WELCOME":
            break
    assert (master.state, master.counts) == ("established", (0, 0, 0))


@pytest.mark.parametrize("network", NETWORKS)
def test_each_sealed_datagram_is_equal_to_the_byte_and_each_force_to_the_bit(lib, network):
    pair = Pair(lib, network, key=KEY)
    pair.run(2.5)
    pair.check(least_n=0.0 if network in ("near the end", "too slow") else 3.0)
    assert all(data[1] == 2 for _, data in pair.of_c.forward.log)


def test_a_shared_key_is_used_and_a_slave_without_it_can_only_refuse(lib):
    pair = Pair(lib, "lossy", key=SHARED, masters=[SHARING])
    pair.run(1.5)
    pair.check(least_n=3.0)
    other = Pair(lib, "slow", key=SHARED, masters=[OTHER_ENTRY])
    other.run(1.0)
    other.check()
    assert (other.of_c.master.state, other.of_c.master.reason[1]) == ("closed", Code.KEY)
    wrong = Pair(lib, "slow", key=SHARED, masters=[ENTRY])  # listed, but without the shared key
    wrong.run(1.0)
    wrong.check()
    assert wrong.of_c.master.state == "connecting"


def test_the_keys_of_both_directions_change_with_the_epoch(lib):
    """The master's numbers are moved to near the end of an epoch; the slave begins there."""
    pair = Pair(lib, "disorder", key=KEY)
    pair.run(0.5)
    for loop in pair.loops:
        (context,) = loop.slave.contexts
        context.session._sequence = 2**20 - 20
    for sequence in (2**20 - 300, 2**21 - 300):
        pair.of_python.master.session._stream.sequence = sequence
        lib.shim_set_sequence(pair.of_c.master.pointer, sequence)
        pair.run(0.7)
    pair.check(least_n=3.0)
    seal = pair.of_python.master.session._stream.seal
    assert (seal.send_epoch, seal.receive_epoch) == (2, 1)


def test_a_session_whose_numbers_run_out_is_replaced_by_another(lib):
    pair = Pair(lib, "slow", key=KEY)
    pair.run(0.5)
    for loop in pair.loops:
        session = loop.slave.contexts[0].session
        loop.number, session.seal.receive_epoch = session.number, (LAST_SEQUENCE - 40_000) >> 20
    pair.of_python.master.session._stream.seal.send_epoch = (LAST_SEQUENCE - 40_000) >> 20
    lib.shim_set_epoch(pair.of_c.master._keys, (LAST_SEQUENCE - 40_000) >> 20)
    pair.of_python.master.session._stream.sequence = LAST_SEQUENCE - 33_000
    lib.shim_set_sequence(pair.of_c.master.pointer, ctypes.c_uint32(LAST_SEQUENCE - 33_000))
    pair.run(1.5)
    pair.check(least_n=3.0)
    for loop in pair.loops:
        assert [context.session.number != loop.number for context in loop.slave.contexts] == [True]


def test_forged_datagrams_neither_end_nor_disturb_a_sealed_session(lib):
    pair = Pair(lib, "slow", key=KEY)
    pair.run(1.0)
    master = pair.of_c.master
    number = msgpack.unpackb(pair.of_c.feedback.log[-1][1])[2]
    before = master.counts[0]
    for kind in (5, 6, 7, 10):
        for body in (b"", bytes(15), bytes(16), bytes(200), msgpack.packb(["forged", 6])):
            for version in (1, 2):
                master.receive_datagram(msgpack.packb([version, kind, number, 1 << 20, body]), pair.of_c.now_us)
    assert master.state == "established"
    assert master.counts[0] == before + 20
    genuine = pair.of_c.feedback.log[-1][1]
    for at in range(len(genuine)):
        master.receive_datagram(genuine[:at] + bytes([genuine[at] ^ 1]) + genuine[at + 1 :], pair.of_c.now_us)
    assert master.state == "established"


def test_a_refuse_without_a_seal_is_only_a_hint(lib):
    master = peer.Master(lib, iter(range(10**6)).__next__, lambda _: (0.0,))
    assert master.seal(MASTER.private, SLAVE.public, None)
    master.tick(0)
    (hello,) = master.datagrams_to_send()
    nonce = msgpack.unpackb(msgpack.unpackb(hello)[4])[0]
    for _ in range(3):
        master.receive_datagram(msgpack.packb([1, 3, 0, 0, msgpack.packb([nonce, "only open ones", 7])]), 1000)
    assert (master.state, master.reason, master.counts) == ("connecting", ("only open ones", 7), (0, 2, 0))


def test_a_key_of_low_order_is_refused(lib):
    master = peer.Master(lib, lambda: 7, lambda _: (0.0,))
    assert not master.seal(MASTER.private, bytes(32), None)


@pytest.mark.parametrize("network", NETWORKS)
def test_a_sealed_slave_answers_at_the_same_times_and_its_forces_are_equal_to_the_bit(lib, network):
    pair = SlavePair(lib, network, key=SHARED, masters=[OTHER_ENTRY, SHARING])
    pair.run(2.5)
    pair.check(0.0 if network in ("near the end", "too slow") else 3.0)


def test_both_sealed_ends_in_c_agree_with_both_in_python_and_change_their_keys(lib):
    pair = SlavePair(lib, "disorder", key=KEY, master=lambda *asked: in_c(lib, *asked))
    pair.run(0.5)
    for loop in pair.loops:
        lib.shim_set_sequence(loop.master.pointer, ctypes.c_uint32(2**20 - 300))
    pair.run(1.0)
    pair.check(3.0)
    for loop in pair.loops:
        loop.close("done")
        assert loop.master.state == "closed"


def test_a_sealed_slave_refuses_a_master_that_is_not_listed(lib):
    pair = SlavePair(lib, "slow", key=KEY, masters=[OTHER_ENTRY])
    pair.run(1.0)
    assert [loop.master.refused for loop in pair.loops] == [True, True]
    assert "does not know the master's key" in pair.loops[1].master.end_reason


def test_a_sealed_slave_follows_its_master_to_another_address(lib):
    """And answers only datagrams that open: a copy or a forgery from elsewhere moves nothing."""
    pair = SlavePair(lib, "perfect", key=KEY, master=lambda *asked: in_c(lib, *asked))
    pair.run(0.5)
    loop = pair.loops[1]
    master, slave, now_us = loop.master, loop.slave, loop.now_us
    for address in ("home", "train", "home"):
        now_us += 46_000
        master.tick(now_us)
        (data,) = master.datagrams_to_send()
        slave.receive_datagram(bytes([*data[:-1], data[-1] ^ 1]), "thief", now_us)
        assert slave.datagrams_to_send() == []
        slave.receive_datagram(data, address, now_us)
        assert [to for _, to in slave.datagrams_to_send()] == [address]
        slave.receive_datagram(data, "thief", now_us)
        assert slave.datagrams_to_send() == []


def test_a_sealed_slave_does_not_answer_who_does_not_know_its_key(lib):
    slave = peer.Slave(lib, lambda: 0xDEADBEEF, Wall(1))
    assert slave.seal(MASTER.private, [(ENTRY.public, ENTRY.psk)])  # the key of another slave
    master = peer.Master(lib, lambda: 7, lambda _: (0.0,))
    assert master.seal(MASTER.private, SLAVE.public, None)
    master.tick(0)
    (hello,) = master.datagrams_to_send()
    slave.receive_datagram(hello, "here", 0)
    assert slave.datagrams_to_send() == []
    slave.receive_datagram(position(1, 0), "here", 0)
    assert [msgpack.unpackb(data)[:2] for data, _ in slave.datagrams_to_send()] == [[1, 8]]
