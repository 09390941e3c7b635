"""The C slave: vectors, and live sessions with masters of hapticnet and of the library itself, in virtual time."""

import json
import math
import re

import msgpack
import numpy as np
import pytest
from test_c_sessions import NETWORKS, WRAP_US, Felt, Spring, Watched, in_c, in_python

import peer
from hapticnet.node.loopback import Loopback
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.handshake import SealedDoor
from hapticnet.protocol.keys import Roster
from hapticnet.protocol.messages import Code
from hapticnet.protocol.wire import SEALED
from hapticnet.samples import ForceSample
from tests.peers import ENTRY, SLAVE

VECTORS = peer.HERE.parents[1] / "tests" / "vectors"
PROTOCOL = {each["name"]: each for each in json.loads((VECTORS / "protocol.json").read_text())["datagrams"]}
REFUSED = json.loads((VECTORS / "refused.json").read_text())
TRACE = json.loads((VECTORS / "traces.json").read_text())["slave"]
SESSION = 0xDEADBEEF
HERE, THERE = ("here", 1), ("there", 2)
WELCOME, REFUSE, POSITION, FORCE, CLOSE, RESET, COOKIE = 2, 3, 4, 5, 7, 8, 9


class Wall(Spring):
    """The scene of the traces: a spring of 300 N/m behind 20 mm."""

    def step(self, sample):
        return ForceSample(sample.t_us, tuple(300.0 * max(0.0, x - 0.02) for x in sample.position_m))


def greeted(lib, request=None, *, version=1, address=HERE, now_us=0, slave=None):
    """Return a slave that has read a request, and its last answer; its numbers are all 0xdeadbeef."""
    slave = slave or peer.Slave(lib, lambda: SESSION, Wall(1))
    fields = msgpack.unpackb(msgpack.unpackb(bytes.fromhex(PROTOCOL["hello"]["hex"]))[4])
    fields[2], cookie = fields[2] if request is None else request, b""
    fields[4] = bytes(400)
    for _ in range(2):
        fields[1] = cookie
        slave.receive_datagram(msgpack.packb([version, 1, 0, 0, msgpack.packb(fields)]), address, now_us)
        answers = slave.datagrams_to_send()
        if not answers:
            return slave, None
        answer = msgpack.unpackb(answers[0][0])
        if answer[1] == COOKIE:
            cookie = msgpack.unpackb(answer[4])[1]
    return slave, answer


def position(sequence, now_us, x_m=0.03, newest=None, session=SESSION):
    body = msgpack.packb([now_us % 2**32, newest, np.array([x_m], ">f4").tobytes()])
    return msgpack.packb([1, POSITION, session, sequence, body])


def sent(slave, data, address=HERE, now_us=1000):
    """Return kind, sequence and fields of the answer to a datagram; None if there is none."""
    slave.receive_datagram(data, address, now_us)
    answers = slave.datagrams_to_send()
    if not answers:
        return None
    _, kind, _, sequence, body = msgpack.unpackb(answers[0][0])
    return kind, sequence, msgpack.unpackb(body) if body else None


def test_a_request_with_its_cookie_is_granted(lib):
    _, answer = greeted(lib)
    assert answer[:4] == [1, WELCOME, SESSION, 0]
    session, rate_hz, keepalive_us, scene, ticket, *rest = msgpack.unpackb(msgpack.unpackb(answer[4])[1])
    assert (session, rate_hz, keepalive_us, scene, len(ticket)) == (SESSION, 1000.0, 45_000, "in C", 16)
    assert rest == [False, False, 0.0]


PARTS = re.compile("part |parts|grip|a threshold")  # a slave of one force refuses all of them as other parts


@pytest.mark.parametrize("case", REFUSED["requests"], ids=lambda case: case["name"])
def test_the_slave_refuses_the_requests_that_it_must(lib, case):
    slave, answer = greeted(lib, bytes.fromhex(case["hex"]))
    if case["outcome"] == "dropped":
        assert answer is None
        assert slave.counts[0] == 1
    elif case["outcome"] == "taken":
        assert answer[1] == WELCOME
    else:
        assert answer[1] == REFUSE
        code = Code.AXES if PARTS.search(case["name"]) and case["outcome"] == 3 else case["outcome"]
        assert msgpack.unpackb(answer[4])[2] == code


@pytest.mark.parametrize(
    "case", [case for case in REFUSED["datagrams"] if case["to"] == "slave"], ids=lambda case: case["name"]
)
def test_the_slave_refuses_the_datagrams_that_it_must(lib, case):
    slave, _ = greeted(lib)
    assert sent(slave, position(1, 1000))[0] == FORCE
    kind = (sent(slave, bytes.fromhex(case["hex"]), now_us=47_000) or [None])[0]
    assert slave.counts == (case["outcome"] == "dropped", 0, 0)
    assert (kind is None) == (case["outcome"] == "dropped")


def test_the_slave_answers_each_position_of_the_trace_to_the_byte(lib):
    slave, _ = greeted(lib)
    for entry in TRACE:
        slave.receive_datagram(bytes.fromhex(entry["arrives"]), HERE, entry["now_us"])
        assert [data.hex() for data, _ in slave.datagrams_to_send()] == ([entry["answer"]] if entry["answer"] else [])


def test_versions_that_are_not_served_are_refused_with_their_code(lib):
    for version, code in ((2, Code.KEY), (3, Code.VERSION)):
        _, answer = greeted(lib, version=version)
        assert answer[:2] == [1, REFUSE]
        assert msgpack.unpackb(answer[4])[2] == code


def test_a_cookie_is_worth_nothing_at_another_address(lib):
    slave = peer.Slave(lib, iter(range(10**6)).__next__, Wall(1))
    hello = msgpack.unpackb(bytes.fromhex(PROTOCOL["hello with the cookie"]["hex"]))
    _, _, (nonce, cookie) = sent(slave, msgpack.packb(hello), HERE)
    fields = msgpack.unpackb(hello[4])
    stolen = msgpack.packb([*hello[:4], msgpack.packb([nonce, cookie, *fields[2:]])])
    assert sent(slave, stolen, THERE)[0] == COOKIE
    assert sent(slave, stolen, HERE)[0] == WELCOME
    assert sent(slave, stolen, HERE)[0] == WELCOME  # the same again, if that was lost


def test_a_request_is_read_once_and_a_small_hello_never(lib):
    slave, _ = greeted(lib)
    assert sent(slave, position(1, 1000))[0] == FORCE
    hello = msgpack.unpackb(bytes.fromhex(PROTOCOL["hello"]["hex"]))
    fields = msgpack.unpackb(hello[4])
    fields[1] = SESSION.to_bytes(4, "little") * 4
    assert sent(slave, msgpack.packb([*hello[:4], msgpack.packb(fields)])) is None
    assert sent(slave, msgpack.packb([*hello[:4], msgpack.packb([*fields[:4], b""])]), THERE) is None


def test_a_datagram_of_another_session_or_address_is_answered_by_reset(lib):
    slave, _ = greeted(lib)
    assert sent(slave, position(1, 1000))[0] == FORCE
    assert sent(slave, position(2, 2000), THERE)[:2] == (RESET, 2)
    assert sent(slave, position(7, 2000, session=70_000))[:2] == (RESET, 7)
    assert slave.counts == (0, 2, 0)


def test_a_second_master_is_refused_until_the_first_is_silent_for_a_second(lib):
    slave, _ = greeted(lib)
    assert sent(slave, position(1, 1000))[0] == FORCE
    _, answer = greeted(lib, slave=slave, address=THERE, now_us=900_000)
    assert (answer[1], msgpack.unpackb(answer[4])[2]) == (REFUSE, Code.FULL)
    fields = msgpack.unpackb(msgpack.unpackb(bytes.fromhex(PROTOCOL["hello"]["hex"]))[4])
    fields[0] += 1
    _, answer = greeted(lib, slave=slave, address=("elsewhere", 3), now_us=1_100_000)
    assert answer[1] == WELCOME
    assert sent(slave, position(2, 1_150_000), now_us=1_150_000)[0] == FORCE  # the first is back in time
    assert sent(slave, position(1, 1_200_000), ("elsewhere", 3), 1_200_000)[0] in (CLOSE, RESET)


def test_positions_above_the_granted_rate_are_not_served(lib):
    slave, _ = greeted(lib)
    served = [sent(slave, position(1 + i, 1000 + i, 0.03 + 0.01 * (i % 2)), now_us=1000 + i) for i in range(2000)]
    assert (
        1000 <= sum(each is not None for each in served) <= 1003
    )  # those of a second at once, and then 1.2 a millisecond


def test_a_force_that_is_not_finite_closes_the_session(lib):
    slave, _ = greeted(lib)
    slave._scene.step = lambda sample: ForceSample(sample.t_us, (math.nan,))
    kind, _, (reason, code) = sent(slave, position(1, 1000))
    assert (kind, code) == (CLOSE, Code.FAILED)
    assert "finite" in reason


class Pair:
    """A master of hapticnet, once with a slave of hapticnet and once with one in C."""

    def __init__(
        self, lib, network, codec="deadband", *, axes=1, master=in_python, key=None, masters=(ENTRY,), **parameters
    ):
        rng, drawn = np.random.default_rng(5), np.random.default_rng(8)
        doors = None if key is None else {SEALED: SealedDoor(SLAVE.private, Roster(masters), rng)}
        in_c = peer.Slave(lib, lambda: int(drawn.integers(0, 1 << 32)), Spring(axes), f"{axes} springs")
        if key is not None:
            assert in_c.seal(SLAVE.private, [(each.public, each.psk) for each in masters])
        self.felt, self.loops = [], []
        for slave in (SlaveNode(lambda _: Spring(axes), SlaveSettings(), rng, doors=doors), in_c):
            node = master(codec, axes, 1000.0, 1, parameters, key)
            forward, back = Watched(NETWORKS[network], 6), Watched(NETWORKS[network], 7)
            self.felt.append(Felt(node))
            self.loops.append(Loopback(node, slave, forward=forward, feedback=back, start_us=WRAP_US))

    def run(self, seconds):
        for loop in self.loops:
            loop.run(round(1e6 * seconds))

    def check(self, least_n):
        logs = [[(now_us, without_session(data)) for now_us, data in loop.feedback.log] for loop in self.loops]
        assert logs[0] == logs[1]
        assert self.felt[0].forces == self.felt[1].forces
        assert max(math.hypot(*map(float.fromhex, force)) for _, force in self.felt[1].forces) >= least_n


def without_session(data):
    """Return a datagram of the slave without what it draws: numbers, cookies, tickets and keys."""
    version, kind, _, sequence, body = msgpack.unpackb(data)
    return version, kind, sequence, len(body) if version == 2 or kind in (COOKIE, WELCOME) else body


@pytest.mark.parametrize("network", NETWORKS)
def test_each_answer_is_equal_to_the_byte_and_each_force_to_the_bit(lib, network):
    pair = Pair(lib, network)
    pair.run(4.0)
    pair.check(0.0 if network == "too slow" else 3.0)


@pytest.mark.parametrize("parameters", [{}, {"step_n": 0.001}], ids=["floats", "counts"])
@pytest.mark.parametrize("codec", ["raw", "deadband"])
@pytest.mark.parametrize("axes", [2, 3])
def test_both_codecs_agree_on_several_axes_over_bursts(lib, codec, parameters, axes):
    pair = Pair(lib, "bursts", codec, axes=axes, **parameters)
    pair.run(3.0)
    pair.check(3.0)


def test_an_outage_ends_in_the_same_session_or_one_that_continues_it(lib):
    pair = Pair(lib, "lossy")
    pair.run(1.0)
    for loop in pair.loops:
        loop.forward.shut = loop.feedback.shut = ((loop.now_us, loop.now_us + 2_500_000),)
    pair.run(4.0)
    assert {loop.master.session.state.value for loop in pair.loops} == {"established"}
    pair.check(3.0)


def test_both_ends_in_c_agree_with_both_ends_in_python(lib):
    pair = Pair(lib, "disorder", master=lambda *asked: in_c(lib, *asked))
    pair.run(3.0)
    for loop in pair.loops:
        loop.close("done")
        assert loop.master.state == "closed"
    pair.check(3.0)


def test_a_master_is_told_why_the_slave_in_c_closes(lib):
    pair = Pair(lib, "slow")
    pair.run(1.0)
    loop = pair.loops[1]
    loop.slave.close("the arm is tired", Code.FAILED, "loopback")
    loop.run(200_000)
    assert loop.master.end_reason == "the slave closed: the arm is tired"
