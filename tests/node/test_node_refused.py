"""What a peer must refuse: the golden vectors, for both ends of a session, open and sealed."""

import json
from pathlib import Path

import msgpack
import pytest

from hapticnet.errors import PeerError
from hapticnet.protocol.handshake import hello_mac
from hapticnet.protocol.messages import unpack_hello, unpack_position
from hapticnet.protocol.wire import OPEN, Kind, pack, pack_body, unpack
from tests.node.undisturbed import HERE, SESSION, Masters, Slaves, make_master, make_slave
from tests.peers import GRANT, SLAVE, HandMaster, HandSlave
from tests.vectors import make_refused

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "refused.json").read_text())


def test_the_vectors_are_those_of_the_document():
    assert make_refused.document() == VECTORS


def cases(to):
    """Return name and outcome of each datagram, and a function that makes it the next one of a session."""
    for case in VECTORS["datagrams"]:
        data = bytes.fromhex(case["hex"])
        try:
            frame = unpack(data)
        except PeerError:
            frame = None
        if case["to"] == to and len(data) < 1200 - 16:

            def make(ends, frame=frame, data=data):
                return data if frame is None else ends.pack(frame.kind, frame.body)

            yield case["name"], case["outcome"], make


def test_a_slave_drops_them_and_nothing_changes(sealed):
    ends = Slaves(sealed=sealed)
    for name, outcome, datagram in cases("slave"):
        before, steps, data = ends.malformed, ends.disturbed.totals()[0], datagram(ends)
        if outcome == "dropped":
            assert not ends.disturb(data), name
            assert ends.malformed == before + 1, name
            ends.step()
        else:
            for slave in ends.slaves:
                slave.receive_datagram(data, HERE, ends.now_us)
                slave.datagrams_to_send()
            ends.sequence += 1
            assert ends.malformed == before, name
            assert ends.disturbed.totals()[0] == ends.slaves[1].totals()[0] > steps, name


def test_a_master_drops_them_and_nothing_changes(sealed):
    kept = Masters(sealed=sealed)
    for name, outcome, datagram in cases("master"):
        ends = kept if outcome == "dropped" else Masters(sealed=sealed)
        before, held_n = ends.malformed, ends.disturbed.held_n
        assert not ends.disturb(datagram(ends)), name
        assert ends.malformed == before + (outcome != "taken"), name
        ends.disturbed.drive(ends.now_us)
        assert (ends.disturbed.held_n == held_n) is (outcome != "taken"), name
        if outcome == "dropped":
            ends.step()
            continue
        ends.disturbed.tick(ends.now_us + 1000)
        (position,) = ends.slaves[0].said()
        is_acknowledged = unpack_position(position.body).newest == ends.sequence + 1
        assert is_acknowledged is (outcome == "taken"), name


def test_requests_are_taken_refused_with_their_code_or_dropped(sealed):
    for nonce, case in enumerate(VECTORS["requests"], start=1):
        slave = make_slave()
        master = HandMaster(slave, sealed=sealed, nonce=nonce)
        give(master.attempt, bytes.fromhex(case["hex"]))
        master.hello()
        answers = master.hello()
        if case["outcome"] == "dropped":
            assert (answers, slave.unknown_peers.malformed) == ([], 1), case["name"]
        elif case["outcome"] == "taken":
            assert master.grant is not None, case["name"]
        else:
            assert master.refusal.code == case["outcome"], case["name"]
        assert slave.session_count == (case["outcome"] == "taken")


def give(attempt, request):
    """Let an attempt ask with these bytes as its request."""
    if attempt.version == OPEN:
        attempt._request = request
    else:
        attempt._request = attempt._initiator.write(request)
        attempt._mac = hello_mac(SLAVE.public, attempt.nonce, 0, attempt._request)


@pytest.mark.plain
def test_grants_are_taken_or_dropped(sealed):
    for case in VECTORS["grants"]:
        master = make_master(sealed=sealed)
        slave = HandSlave(master, sealed=sealed)
        master.tick(0)
        slave.cookie(slave.hello(), 0)
        hello = slave.hello()
        visitor = slave._door.read(unpack_hello(hello.body), hello.sequence)
        grant = msgpack.unpackb(bytes.fromhex(case["hex"]), strict_map_key=False)
        body = pack_body((unpack_hello(hello.body).nonce, visitor.answer(grant)[0]))
        master.receive_datagram(pack(Kind.WELCOME, SESSION, 0, body, slave.version), 0)
        assert master.session.received.malformed == (case["outcome"] == "dropped"), case["name"]
        assert master.connected == (case["outcome"] == "taken"), case["name"]
        slave.welcome(hello, 0, GRANT)
        assert master.connected, "what was dropped changed nothing"
