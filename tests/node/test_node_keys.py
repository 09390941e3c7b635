"""Whom a slave serves by its list of masters, and what a stolen key or a copied request is good for."""

import pytest

from hapticnet.errors import PeerError
from hapticnet.protocol import noise
from hapticnet.protocol.handshake import hello_mac, prologue
from hapticnet.protocol.keys import NO_PSK, Roster
from hapticnet.protocol.messages import Code, unpack_welcome
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.wire import Kind, pack_body, unpack
from tests.conftest import make_slave
from tests.peers import MASTER, OTHER_ENTRY, OTHER_KEY, OTHER_MASTER, REQUEST, SLAVE, HandMaster

HERE, THERE = ("192.0.2.1", 5000), ("192.0.2.66", 6000)


@pytest.fixture
def slave():
    return make_slave(sealed=True)


def test_a_master_that_is_removed_from_the_list_ends_and_is_not_served_again(slave):
    surgeon = HandMaster(slave, HERE, sealed=True).work()
    student = HandMaster(slave, THERE, sealed=True, nonce=2, key=OTHER_KEY).work()
    slave.serve_only(Roster([OTHER_ENTRY]), 1000)
    ((close, to),) = slave.datagrams_to_send()
    assert (surgeon._read(close).kind, to) == (Kind.CLOSE, HERE)
    assert HandMaster(slave, HERE, sealed=True, nonce=3).refused(2000).code is Code.KEY
    assert [context.address for context in slave.contexts] == [THERE]
    assert student.position(2, 60_000) != []


class Thief(noise.Initiator):
    """Holds the slave's private key, and poses as a master whose public key it knows."""

    def __init__(self, nonce, rng):
        super().__init__(bytes([9] * 32), SLAVE.public, NO_PSK, prologue(nonce, 0), rng)
        self._static = noise._Pair(self._static.private, MASTER.public)
        self._static_shared = noise._shared_secret(noise._pair(SLAVE.private), MASTER.public)


@pytest.mark.plain
def test_a_thief_of_the_slaves_key_forges_a_request_but_can_prove_no_session(slave):
    thief = HandMaster(slave, THERE, sealed=True, nonce=7, key=OTHER_KEY)
    attempt = thief.attempt
    attempt._initiator = Thief(7, slave._admission._rng)
    attempt._request = attempt._initiator.write(pack_body(REQUEST))
    attempt._mac = hello_mac(SLAVE.public, 7, 0, attempt._request)
    thief.hello()
    slave.receive_datagram(attempt.hello(thief.cookie), THERE, 0)
    ((welcome, _),) = slave.datagrams_to_send()
    (context,) = slave.contexts
    assert context.identity == MASTER.public
    with pytest.raises(PeerError, match="does not open"):
        attempt.read(unpack_welcome(unpack(welcome).body).grant)
    for key in (bytes(32), SLAVE.private, OTHER_MASTER.private):
        guessed = Seal(key, key).pack(Kind.POSITION, context.session.number, 1, pack_body((0, None, bytes(4))))
        assert thief.send(guessed, 1000) == []
    assert context.session.state is SlaveState.HALF_OPEN


def test_copies_of_true_positions_do_not_use_up_the_granted_rate(slave):
    master = HandMaster(slave, HERE, sealed=True).join()
    for step in range(1, 3001):
        master.position(step, 1000 * step)
        for _ in range(3):
            assert master.send(master.said[-1], 1000 * step) == []
    received = slave.contexts[0].session.received
    assert (received.duplicate, received.over_rate) == (9000, 0)


def test_a_copied_request_gets_its_sender_a_half_open_session_and_disturbs_nothing(slave):
    master = HandMaster(slave, HERE, sealed=True).join()
    positions = [master.pack(Kind.POSITION, step, (1000 * step, None, bytes(4))) for step in range(1, 51)]
    for step, data in enumerate(positions, start=1):
        master.send(data, 1000 * step)
    (context,) = slave.contexts
    copier = HandMaster(slave, THERE, sealed=True)
    copier.attempt = master.attempt
    assert [answer.kind for answer in copier.hello(51_000)] == [Kind.COOKIE], "the master's is of another address"
    slave.receive_datagram(copier.attempt.hello(copier.cookie), THERE, 51_000)
    ((welcome, to),) = slave.datagrams_to_send()
    assert (unpack(welcome).kind, to) == (Kind.WELCOME, THERE)
    for data in positions:  # no datagram of the running session proves the copied one
        copied = data.replace(master.session.to_bytes(4, "big"), unpack(welcome).session.to_bytes(4, "big"))
        slave.receive_datagram(copied, THERE, 51_000)
    slave.datagrams_to_send()
    assert slave.contexts[0] is context
    assert master.position(51, 100_000) != []
    assert [each.session.state for each in slave.contexts] == [SlaveState.OPEN, SlaveState.HALF_OPEN]
