"""Whom a slave serves by its list of masters, and what a stolen key is good for."""

import pytest

from hapticnet.errors import PeerError
from hapticnet.protocol import noise
from hapticnet.protocol.handshake import SealedAttempt, hello_mac, prologue
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, Roster
from hapticnet.protocol.messages import Code, unpack_cookie, unpack_welcome
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.states import Connected, Ended, Refused, SessionLost, SlaveState
from hapticnet.protocol.wire import Kind, pack_body, unpack
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
