"""What a peer must refuse, and what both ends do with what arrives: golden vectors."""

import json
from pathlib import Path

import msgpack
import numpy as np
import pytest

from hapticnet.errors import PeerError
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.base import UserOperator
from hapticnet.protocol.handshake import hello_mac
from hapticnet.protocol.messages import Close, Hello, pack_hello, unpack_hello, unpack_position
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, pack_body, unpack
from hapticnet.scene.settings import Tissue
from tests.node.undisturbed import HERE, SESSION, Masters, Slaves, make_master, slave_of_session
from tests.peers import GRANT, SLAVE, HandMaster, HandSlave
from tests.vectors import make_refused, make_traces

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "refused.json").read_text())


def test_the_vectors_are_those_of_the_document():
    assert make_refused.document() == VECTORS


def cases(to, sealed):
    """Return name and outcome of each datagram, and a function that makes it the next one of a session."""
    room = 16 if sealed else 0  # for the seal
    for case in VECTORS["datagrams"]:
        data = bytes.fromhex(case["hex"])
        try:
            frame = unpack(data)
        except PeerError:
            frame = None
        if case["to"] == to and len(data) + room <= 1201:

            def make(ends, frame=frame, data=data):
                return data if frame is None else ends.pack(frame.kind, frame.body)

            yield case["name"], case["outcome"], make


def test_a_slave_drops_them_and_nothing_changes(sealed):
    ends = Slaves(sealed=sealed)
    for name, outcome, datagram in cases("slave", sealed):
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
    for name, outcome, datagram in cases("master", sealed):
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
        slave = slave_of_session()
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


STRANGER = ("10.66.66.66", 6)
EDGES = (0, 1, 2, 127, 128, 3000, 2**16, 2**20 - 1, 2**20, 2**21, 2**31 - 1, 2**31, 2**32 - 1)
KINDS = (0, *Kind, 11)


class Forger:
    """Makes datagrams without a key, a cookie, or a place at the address of either end."""

    def __init__(self, ends, seed, *, sealed):
        self.ends, self.sealed = ends, sealed
        self.rng = np.random.default_rng([seed, 66])
        self.tricks = [self.invented, self.flipped, self.cut, self.garbage, self.hello, self.close, self.misaddressed]
        if isinstance(ends, Slaves):
            self.tricks.append(self.replayed)

    def any(self, values):
        return values[int(self.rng.integers(len(values)))]

    def __call__(self):
        """Return a forged datagram and the address that it seems to come from."""
        return self.any(self.tricks)()

    def true(self):
        """Return what the other end could send next."""
        if isinstance(self.ends, Slaves):
            return self.ends.pack(Kind.POSITION, (self.ends.now_us, None, bytes(4)))
        return self.ends.pack(Kind.FORCE, (self.ends.now_us, bytes(4)))

    def sequence(self):
        return self.any((*EDGES, self.ends.sequence, self.ends.sequence + 1, self.ends.sequence + 2))

    def place(self):
        """Return an address: under a seal it proves nothing, in an open session it is all there is."""
        return self.any((HERE, STRANGER)) if self.sealed else STRANGER

    def invented(self):
        body = self.any(
            (b"", bytes(16), self.rng.bytes(40), pack_body((1, None, bytes(4))), pack_body(Close("forged")))
        )
        version = SEALED if self.sealed else self.any((OPEN, SEALED))
        return pack(self.any(KINDS), SESSION, self.sequence(), body, version), self.place()

    def flipped(self):
        data = bytearray(self.true())
        at = int(self.rng.integers(len(data))) if self.sealed else int(self.rng.integers(4, 8))
        data[at] ^= 1 << int(self.rng.integers(8))
        return bytes(data), self.place() if self.sealed else HERE

    def cut(self):
        data = self.true()
        return data[: int(self.rng.integers(len(data)))], self.any((HERE, STRANGER))

    def garbage(self):
        return self.rng.bytes(int(self.rng.integers(0, 1300))), self.any((HERE, STRANGER))

    def hello(self):
        hello = Hello(int(self.rng.integers(2**32)), self.any((b"", bytes(16))), self.rng.bytes(100), bytes(16))
        return pack_hello(hello, self.any(EDGES), self.any((OPEN, SEALED, 3))), self.any((HERE, STRANGER))

    def replayed(self):
        """Return a HELLO that the master sent, as if it came from there again."""
        return self.any(self.ends.masters[0].said), HERE

    def close(self):
        session = SESSION ^ (1 << int(self.rng.integers(32)))
        return pack(Kind.CLOSE, session, self.sequence(), pack_body(Close("forged")), self.any((OPEN, SEALED))), HERE

    def misaddressed(self):
        """Return a message of the wrong version, session or kind, or a right one from a stranger's address."""
        if not self.sealed and self.rng.random() < 0.5:
            return self.true(), STRANGER
        frame = unpack(self.true())
        changed = self.any(({"version": 3 - frame.version}, {"session": SESSION - 1}, {"kind": self.any(UNANSWERED)}))
        frame = frame._replace(**changed)
        return pack(frame.kind, frame.session, frame.sequence, frame.body, frame.version), self.any((HERE, STRANGER))


UNANSWERED = (Kind.WELCOME, Kind.REFUSE, Kind.COOKIE)


"""Kinds that neither end of a session takes from the other."""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("line", [False, True], ids=["each", "line"])
def test_a_slave_serves_its_sessions_as_if_nothing_had_been_forged(line, sealed, seed):
    ends = Slaves(sealed=sealed, line=line)
    forger = Forger(ends, seed, sealed=sealed)
    for number in range(600):
        data, address = forger()
        ends.disturb(data, address)
        if number % 5 == 0:
            ends.step()
    (context, *_), (other, *_) = (slave.contexts for slave in ends.slaves)
    assert ends.disturbed.session_count == 1
    assert context.address == other.address == HERE


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("line", [False, True], ids=["each", "line"])
def test_a_master_goes_on_as_if_nothing_had_been_forged(line, sealed, seed):
    ends = Masters(sealed=sealed, line=line)
    forger = Forger(ends, seed, sealed=sealed)
    for number in range(600):
        data, address = forger()
        # A master hears its slave's address only: the socket sees to that.
        if sealed or address == HERE or not is_of_session(data):
            assert not ends.disturb(data), data
        if number % 5 == 0:
            ends.step()


def is_of_session(data):
    try:
        return unpack(data).session == SESSION
    except PeerError:
        return False


@pytest.mark.parametrize("ends_of", [Slaves, Masters])
def test_ten_thousand_datagrams_of_garbage_are_counted_and_change_nothing(ends_of, sealed):
    ends, rng = ends_of(sealed=sealed), np.random.default_rng(2)
    good = ends.pack(Kind.POSITION if ends_of is Slaves else Kind.FORCE, (ends.now_us, bytes(9), bytes(4)))
    before = ends.malformed
    for number in range(10_002):
        data = (rng.bytes(int(rng.integers(0, 80))), good[: number % len(good)], bytes(1201 + number % 300))[number % 3]
        assert ends.disturb(data) == []
    assert ends.malformed == before + 10_002
    ends.step()


def test_what_is_replayed_from_under_an_earlier_key_costs_nothing(monkeypatch):
    monkeypatch.setattr("hapticnet.protocol.seal.EPOCH_BITS", 6)
    ends = Slaves(sealed=True)
    for _ in range(60):
        ends.step()
    for data in ends.said[60:]:
        for address in (HERE, STRANGER):
            assert ends.disturb(data, address) == []
    ends.step()


TRACES = json.loads((Path(__file__).parents[1] / "vectors" / "traces.json").read_text())


def test_the_traces_are_those_of_the_document():
    assert make_traces.document() == TRACES


@pytest.mark.parametrize("trace", TRACES["traces"], ids=lambda trace: trace["name"])
def test_a_master_follows_a_golden_trace(trace):
    places = {tick["now_us"]: tick["position_m"] for tick in trace["ticks"]}

    class Hand:
        axes = 1

        def sample(self, t_us):
            return places[t_us]

    settings = MasterSettings(codec=trace["codec"], rate_hz=trace["rate_hz"])
    master = MasterNode(UserOperator(Hand()), None, settings, np.random.default_rng(1))
    slave = HandSlave(master).connect(grant=GRANT._replace(session=SESSION))
    for tick in trace["ticks"]:
        now_us = tick["now_us"]
        master.tick(now_us)
        (position,) = slave.said()
        assert unpack_position(position.body).newest == tick["newest"], now_us
        for arrival in tick["arrives"]:
            master.receive_datagram(bytes.fromhex(arrival["hex"]), now_us)
        master.drive(now_us)
        assert list(master.received_n) == tick["stimulus_n"], now_us


def test_a_slave_follows_a_golden_trace():
    spring = Tissue(name="spring", rest_position_m=0.02, stiffness_n_per_m=300.0, breach_force_n=1e6)
    slave = slave_of_session((spring,))
    HandMaster(slave, HERE).join()
    for entry in TRACES["slave"]:
        slave.receive_datagram(bytes.fromhex(entry["arrives"]), HERE, entry["now_us"])
        answers = [data.hex() for data, _ in slave.datagrams_to_send()]
        assert answers == [entry["answer"]] * (entry["answer"] is not None), entry
