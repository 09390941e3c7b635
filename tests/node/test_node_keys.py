"""Whom a slave serves by its list of masters, and what a stolen key is good for."""

import struct

import msgpack
import pytest

from hapticnet.errors import PeerError
from hapticnet.protocol import noise
from hapticnet.protocol.handshake import SealedAttempt, hello_mac, prologue
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, Roster
from hapticnet.protocol.messages import Code, Cookie, Grant, Welcome, unpack_cookie, unpack_welcome
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.states import (
    Connected,
    Ended,
    ForceArrived,
    HoldConfirmed,
    MasterState,
    Refused,
    SessionLost,
    SlaveState,
)
from hapticnet.protocol.wire import OPEN, Kind, pack, pack_body, unpack
from tests.node.wire_tap import ENTRIES, REQUEST, SLAVE, STUDENT, SURGEON, Tap

HERE, THERE = ("192.0.2.1", 5000), ("192.0.2.66", 6000)


@pytest.fixture
def tap():
    return Tap()


def kinds(events):
    return [type(event) for event in events]


def test_a_master_that_is_removed_from_the_list_ends_and_is_not_served_again(tap):
    surgeon, student = tap.master(SURGEON), tap.master(STUDENT)
    tap.run(surgeon, HERE)
    tap.run(student, THERE)
    tap.slave.serve_only(Roster(ENTRIES[1:]), tap.now_us)
    ((close, to),) = tap.slave.datagrams_to_send()
    assert to == HERE
    surgeon.receive_datagram(close, tap.now_us)
    events = tap.run(surgeon, HERE, 3000)
    assert kinds(events)[0] is SessionLost
    refusals = [event for event in events if isinstance(event, Refused)]
    assert {event.code for event in refusals} == {Code.KEY}
    assert [event.retry_us for event in refusals] == [1_000_000, 2_000_000]
    assert Connected not in kinds(events)
    (context,) = tap.slave.contexts
    assert context.address == THERE
    assert SessionLost not in kinds(tap.run(student, THERE))


def test_a_key_gets_no_more_sessions_than_its_entry_says():
    tap = Tap([MasterEntry(name="surgeon", public=SURGEON.public, most_sessions=1)])
    first, second = tap.master(SURGEON), tap.master(SURGEON, REQUEST._replace(name="another device"))
    tap.run(first, HERE)
    (ended,) = tap.run(second, THERE)
    assert (type(ended), ended.refused, ended.code) == (Ended, True, Code.FULL)
    assert [context.address for context in tap.slave.contexts] == [HERE]


def test_no_key_continues_the_scene_of_another(tap):
    surgeon = tap.master(SURGEON)
    tap.run(surgeon, HERE)
    (context,) = tap.slave.contexts
    tap.now_us += 500_000  # silent, as a master that restarts
    by_name = tap.master(STUDENT)
    by_ticket = tap.master(STUDENT, REQUEST._replace(name="thief"))
    by_ticket._asking.stop()
    by_ticket._asking.begin(context.grant.ticket)
    for thief in (by_name, by_ticket):
        (connected,) = (event for event in tap.run(thief, THERE) if isinstance(event, Connected))
        assert not connected.grant.resumed
    assert tap.slave.contexts[0] is context
    assert len({id(each.scene) for each in tap.slave.contexts}) == 3


class Thief(noise.Initiator):
    """Holds the slave's private key, and poses as a master whose public key it knows."""

    def __init__(self, nonce, rng):
        super().__init__(bytes([9] * 32), SLAVE.public, NO_PSK, prologue(nonce, 0), rng)
        self._static = noise._Pair(self._static.private, SURGEON.public)
        self._static_shared = noise._shared_secret(noise._pair(SLAVE.private), SURGEON.public)


@pytest.mark.plain
def test_a_thief_of_the_slaves_key_forges_a_request_but_can_prove_no_session(tap):
    nonce = 7
    attempt = SealedAttempt(REQUEST, nonce, 0, MasterKey(STUDENT, SLAVE.public), tap.rng)
    attempt._initiator = Thief(nonce, tap.rng)
    attempt._request = attempt._initiator.write(pack_body(REQUEST))
    attempt._mac = hello_mac(SLAVE.public, nonce, 0, attempt._request)
    ((cookie, _),) = tap.to_slave(attempt.hello(b""), THERE)
    ((welcome, _),) = tap.to_slave(attempt.hello(unpack_cookie(unpack(cookie).body).cookie), THERE)
    (context,) = tap.slave.contexts
    assert context.identity == SURGEON.public
    with pytest.raises(PeerError, match="does not open"):
        attempt.read(unpack_welcome(unpack(welcome).body).grant)
    for key in (bytes(32), SLAVE.private, SURGEON.public):
        guessed = Seal(key, key).pack(Kind.POSITION, context.session.number, 1, pack_body((0, None, bytes(4))))
        assert tap.to_slave(guessed, THERE) == []
    assert context.session.state is SlaveState.HALF_OPEN


@pytest.fixture
def master(tap):
    made = tap.master()
    assert any(isinstance(event, Connected) for event in tap.run(made, HERE))
    return made


def numbers_of(data):
    frame = unpack(data)
    return frame.kind, frame.session, frame.sequence


@pytest.mark.parametrize("forged", [1, 5000, 2**31, 2**32 - 1])
def test_a_welcome_whose_frame_was_changed_deafens_nobody(tap, forged):
    def change(data):
        frame = msgpack.unpackb(data)
        if frame[1] != Kind.WELCOME:
            return data
        frame[2:4] = [12345, forged]
        return msgpack.packb(frame)

    master = tap.master()
    events = [event for _ in range(100) for event in tap.step(master, HERE, back=change)]
    assert [type(event) for event in events[:2]] == [Connected, ForceArrived]
    assert any(isinstance(event, HoldConfirmed) for event in events)
    assert master.received.late == 0


def test_copies_of_true_positions_do_not_use_up_the_granted_rate(tap, master):
    for _ in range(3000):
        tap.step(master, HERE)
        for _ in range(3):
            assert tap.to_slave(tap.sent[-1], HERE) == []
    (context,) = tap.slave.contexts
    assert context.session.received.duplicate == 9000
    assert context.session.received.over_rate == 0


def test_a_copy_from_another_address_moves_nothing(tap, master):
    tap.step(master, HERE)
    assert tap.to_slave(tap.sent[-1], THERE) == []
    (context,) = tap.slave.contexts
    assert context.address == HERE


def test_who_forwards_a_position_first_gets_the_answers_until_the_next_one_and_can_open_none(tap, master):
    tap.now_us += 50_000  # so that a KEEPALIVE is due
    master.send_position(tap.now_us, b"\0\0\0\0")
    (data,) = master.datagrams_to_send()
    ((answer, to),) = tap.to_slave(data, THERE)
    assert to == THERE
    with pytest.raises(ValueError, match=r"unpack|extra|data"):
        msgpack.unpackb(unpack(answer).body)
    assert len(answer) <= len(data)
    tap.step(master, HERE)
    (context,) = tap.slave.contexts
    assert context.address == HERE


@pytest.mark.usefixtures("master")
def test_an_observer_sees_neither_names_nor_keys_nor_forces(tap):
    seen = tap.sent + tap.answers
    hellos = [data for data in seen if unpack(data).kind is Kind.HELLO]
    assert hellos
    for secret in (REQUEST.name.encode(), SURGEON.public, SLAVE.public, b"deadband"):
        assert not any(secret in data for data in seen)
    positions = [unpack(data).body for data in tap.sent if unpack(data).kind is Kind.POSITION]
    assert len(set(positions)) == len(positions)  # although the tool stands still
    assert not any(struct.pack(">f", 0.001) in body for body in positions)


def test_a_copied_request_gets_its_sender_a_half_open_session_and_disturbs_nothing(tap, master):
    nonce, _, *rest = msgpack.unpackb(unpack(tap.sent[1]).body)
    (context,) = tap.slave.contexts
    hello = tap.sent[1]
    assert unpack(hello).kind is Kind.HELLO
    ((cookie, _),) = tap.to_slave(hello, THERE)  # its cookie is of another address
    (_, cookie) = msgpack.unpackb(unpack(cookie).body)
    body = pack_body((nonce, cookie, *rest))
    ((welcome, to),) = tap.to_slave(pack(Kind.HELLO, 0, unpack(hello).sequence, body, 2), THERE)
    assert (unpack(welcome).kind, to) == (Kind.WELCOME, THERE)
    assert [each.session.state for each in tap.slave.contexts] == [SlaveState.OPEN, SlaveState.HALF_OPEN]
    for data in tap.sent[-50:]:  # no datagram of the running session proves the copied one
        kind, _, sequence = numbers_of(data)
        tap.to_slave(pack(kind, unpack(welcome).session, sequence, unpack(data).body, 2), THERE)
    assert tap.run(master, HERE)
    assert tap.slave.contexts[0] is context
    assert context.session.state is SlaveState.OPEN
    assert [each.session.state for each in tap.slave.contexts[1:]] == [SlaveState.HALF_OPEN]


def test_a_master_with_a_key_takes_no_open_session(tap):
    master = tap.master()
    master.tick(tap.now_us)
    (hello,) = master.datagrams_to_send()
    nonce = msgpack.unpackb(unpack(hello).body)[0]
    grant = pack_body(Grant(70_000, 1000.0, 45_000, "paper:1", bytes(16), False))
    master.receive_datagram(pack(Kind.COOKIE, 0, 0, pack_body(Cookie(nonce, bytes(16))), OPEN), tap.now_us)
    for version in (1, 2):
        master.receive_datagram(pack(Kind.WELCOME, 70_000, 0, pack_body(Welcome(nonce, grant)), version), tap.now_us)
    assert master.state is MasterState.CONNECTING
    assert all(unpack(data).version == 2 for data in master.datagrams_to_send())
    assert any(isinstance(event, Connected) for event in tap.run(master, HERE, 300))
