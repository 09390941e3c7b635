"""What a slave answers to single datagrams: versions, cookies, strangers, too many positions, other addresses."""

import math

import msgpack
import numpy as np
import pytest

from conformance.child import read_hex, write_float, write_hex
from conformance.golden import HERE, SESSION, Talk, datagrams, master, position
from conformance.scenes import Hand, Spring
from conformance.script import random_line
from conformance.session import ENTRY, KEY, MASTER, SLAVE, PeerSlave, listed
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.base import UserOperator
from hapticnet.protocol.messages import Code
from hapticnet.protocol.wire import Kind

THERE = write_hex("there")


@pytest.fixture
def talk(child):
    """A slave of a peer without a session."""
    if not child.has("roles", "slave"):
        pytest.skip(f"{child.peer.name} has no slave")
    return Talk(child)


@pytest.fixture
def served(talk):
    """A slave that serves session 0xdeadbeef."""
    assert talk.greet()[:3] == [1, Kind.WELCOME, SESSION]
    assert talk.say(position(1, 1000))[1] == Kind.FORCE
    return talk


def hello(**changed):
    """Return the HELLO of the vectors with other fields, by their number."""
    frame = msgpack.unpackb(bytes.fromhex(datagrams()["hello with the cookie"]))
    fields = msgpack.unpackb(frame[4])
    for name, value in changed.items():
        fields[int(name[1:])] = value
    return fields[1], msgpack.packb([*frame[:4], msgpack.packb(fields)])


def test_a_request_is_granted_with_the_name_of_the_scene(talk):
    answer = talk.greet()
    session, rate_hz, keepalive_us, scene, ticket, *rest = msgpack.unpackb(msgpack.unpackb(answer[4])[1])
    assert (session, rate_hz, keepalive_us, scene, len(ticket)) == (SESSION, 1000.0, 45_000, "a spring", 16)
    assert rest[:3] == [False, False, 0.0]


@pytest.mark.parametrize(("version", "code"), [(2, Code.KEY), (3, Code.VERSION), (4_000_000_000, Code.VERSION)])
def test_a_version_that_is_not_served_is_refused_with_its_code(talk, version, code):
    answer = talk.greet(version=version)
    assert answer[:2] == [1, Kind.REFUSE]
    assert msgpack.unpackb(answer[4])[2] == code


def test_a_cookie_is_worth_nothing_at_another_address(talk):
    talk = Talk(talk.child, random_line(4).command)
    _, first = hello()
    cookie = msgpack.unpackb(talk.say(first, HERE)[4])[1]
    _, stolen = hello(_1=cookie)
    assert talk.say(stolen, THERE)[1] == Kind.COOKIE
    assert talk.say(stolen, HERE)[1] == Kind.WELCOME
    assert talk.say(stolen, HERE)[1] == Kind.WELCOME  # the same again, if that was lost


def test_a_request_is_read_once_and_a_small_hello_never(talk):
    _, first = hello()
    cookie = msgpack.unpackb(talk.say(first)[4])[1]
    _, whole = hello(_1=cookie)
    assert talk.say(whole)[1] == Kind.WELCOME
    assert talk.say(position(1, 1000))[1] == Kind.FORCE
    assert talk.say(whole) is None
    _, small = hello(_1=b"", _4=b"")
    assert talk.say(small, THERE) is None


def test_a_datagram_of_another_session_or_address_is_answered_by_reset(served):
    assert served.say(position(2, 2000), THERE)[1::2] == [Kind.RESET, 2]
    assert served.say(position(7, 2000, session=70_000))[1::2] == [Kind.RESET, 7]
    assert served.counts() == "0 2 0"


def test_a_second_master_is_refused_until_the_first_is_silent_for_a_second(served):
    answer = served.greet(address=THERE, now_us=900_000)
    assert (answer[1], msgpack.unpackb(answer[4])[2]) == (Kind.REFUSE, Code.FULL)
    elsewhere = write_hex("elsewhere")
    assert served.greet(address=elsewhere, now_us=1_100_000, number=1)[1] == Kind.WELCOME
    assert served.say(position(2, 1_150_000), now_us=1_150_000)[1] == Kind.FORCE  # the first is back in time
    assert served.say(position(1, 1_200_000), elsewhere, 1_200_000)[1] in (Kind.CLOSE, Kind.RESET)


def test_positions_above_the_granted_rate_are_not_served(served):
    """Those of a second are served at once, and then 1.2 in a millisecond."""
    answers = [served.say(position(2 + i, 1001 + i, 0.03 + 0.01 * (i % 2)), now_us=1001 + i) for i in range(2000)]
    assert 1000 <= sum(each is not None for each in answers) <= 1003


def test_a_force_that_is_not_finite_closes_the_session(served):
    served.child.ask("receive", 2000, write_hex(position(2, 2000)), HERE)
    answer = msgpack.unpackb(read_hex(served.child.ask("answer", 2000, write_float(math.nan))[0]))
    assert (answer[1], msgpack.unpackb(answer[4])[1]) == (Kind.CLOSE, Code.FAILED)


def test_a_slave_that_closes_tells_its_master_why(served):
    (digits,) = served.child.ask("close", int(Code.FAILED), write_hex("the arm is tired"))
    answer = msgpack.unpackb(read_hex(digits))
    assert (answer[1], msgpack.unpackb(answer[4])) == (Kind.CLOSE, ["the arm is tired", Code.FAILED])


@pytest.fixture
def sealed_slave(child):
    if not child.has("sealed", "slave"):
        pytest.skip(f"{child.peer.name} has no sealed slave")
    return PeerSlave(child, Spring(1), 5, listed(SLAVE, [ENTRY]))


def test_a_sealed_slave_follows_its_master_to_another_address(sealed_slave):
    """And answers only datagrams that open: a copy or a forgery from elsewhere moves nothing."""
    slave, now_us, place = sealed_slave, 0, "home"
    node = MasterNode(UserOperator(Hand(1)), None, MasterSettings(key=KEY), np.random.default_rng(1))
    while now_us < 20_000:
        node.tick(now_us)
        for data in node.datagrams_to_send():
            slave.receive_datagram(data, place, now_us)
        for data, to in slave.datagrams_to_send():
            assert to == place
            node.receive_datagram(data, now_us)
        now_us += 1000
    assert node.connected
    for address in ("home", "train", "home"):
        now_us += 46_000
        node.tick(now_us)
        (data,) = node.datagrams_to_send()
        slave.receive_datagram(bytes([*data[:-1], data[-1] ^ 1]), "thief", now_us)
        assert slave.datagrams_to_send() == []
        slave.receive_datagram(data, address, now_us)
        assert [to for _, to in slave.datagrams_to_send()] == [address]
        slave.receive_datagram(data, "thief", now_us)
        assert slave.datagrams_to_send() == []


@pytest.mark.usefixtures("sealed_slave")
def test_a_sealed_slave_does_not_answer_who_does_not_know_its_key(child):
    other = PeerSlave(child, Spring(1), 5, listed(MASTER, [ENTRY]))
    node = MasterNode(UserOperator(Hand(1)), None, MasterSettings(key=KEY), np.random.default_rng(1))
    node.tick(0)
    (data,) = node.datagrams_to_send()
    other.receive_datagram(data, "here", 0)
    assert other.datagrams_to_send() == []


@pytest.fixture
def sealed_master(child):
    """A peer with a master that can be sealed."""
    if not child.has("sealed", "master"):
        pytest.skip(f"{child.peer.name} has no sealed master")
    child.tell(random_line(4).command)
    child.ask(*master(name="a person").command.split(" "))
    return child


def test_a_key_of_low_order_is_refused(sealed_master):
    (answer,) = sealed_master.batch([f"seal {MASTER.private.hex()} {bytes(32).hex()} -"])
    assert answer.startswith("error ")


def test_a_refuse_without_a_seal_is_only_a_hint(sealed_master):
    sealed_master.ask("seal", MASTER.private.hex(), SLAVE.public.hex(), "-")
    sealed_master.ask("tick", 0, write_float(0.0))
    nonce = msgpack.unpackb(msgpack.unpackb(read_hex(sealed_master.ask("send")[0]))[4])[0]
    for _ in range(3):
        refuse = msgpack.packb([1, Kind.REFUSE, 0, 0, msgpack.packb([nonce, "only open ones", 7])])
        sealed_master.ask("receive", 1000, refuse.hex())
    assert sealed_master.ask("state") == ["connecting"]
    assert sealed_master.ask("reason") == ["7", write_hex("only open ones")]
    assert sealed_master.ask("counts") == ["0", "2", "0"]
