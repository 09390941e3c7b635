"""What a master is granted: its scene, its rate, its numbers."""

from collections import deque

import numpy as np
import pytest

from hapticnet.node.admission import SMALLEST_SESSION
from hapticnet.protocol import slave_session
from hapticnet.protocol.keys import MasterEntry
from hapticnet.protocol.messages import TICKET_BYTES
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.wire import Kind
from tests.conftest import make_slave
from tests.peers import MASTER, HandMaster


@pytest.mark.parametrize(
    ("asked_hz", "entry_hz", "granted_hz"),
    [(500.0, None, 500.0), (50_000.0, None, 10_000.0), (500.0, 200.0, 200.0), (100.0, 200.0, 100.0)],
)
def test_the_lowest_of_the_rates_is_granted(asked_hz, entry_hz, granted_hz):
    entry = MasterEntry(name="surgeon", public=MASTER.public, fastest_rate_hz=entry_hz)
    slave = make_slave(sealed=True, masters=[entry])
    assert HandMaster(slave, sealed=True, rate_hz=asked_hz).join().grant.rate_hz == granted_hz


def test_a_scene_is_made_for_the_entry_of_the_master(sealed):
    entry = MasterEntry(name="surgeon", public=MASTER.public, scene="paper:7")
    slave = make_slave(sealed=sealed, masters=[entry])
    made_for = []
    make_scene = slave._admission._make_scene
    slave._admission._make_scene = lambda known: made_for.append(known) or make_scene(known)
    HandMaster(slave, sealed=sealed).work()
    assert made_for == [entry if sealed else None]


def test_the_slave_knows_a_sealed_master_by_its_key_and_an_open_one_by_its_host(sealed):
    slave = make_slave(sealed=sealed, host_of=lambda address: address[0])
    HandMaster(slave, ("host", 1), sealed=sealed).work()
    (context,) = slave.contexts
    assert context.identity == (MASTER.public if sealed else "host")


def test_numbers_and_tickets_are_large_random_and_all_different(sealed):
    slave = make_slave(sealed=sealed)
    masters = [HandMaster(slave, nonce, sealed=sealed, nonce=nonce).join(10_000 * nonce) for nonce in range(1, 15)]
    grants = [master.grant for master in masters]
    assert len({grant.session for grant in grants}) == len({grant.ticket for grant in grants}) == 14
    assert min(grant.session for grant in grants) >= SMALLEST_SESSION
    assert {len(grant.ticket) for grant in grants} == {TICKET_BYTES}


def test_a_number_in_use_is_not_given_again():
    slave = make_slave()
    first = HandMaster(slave, "a").join().session
    drawn = deque([first, first, first + 1])
    entropy = np.random.default_rng(3)

    class Repeating:
        def integers(self, low, high, /):
            return drawn.popleft() if low == SMALLEST_SESSION else entropy.integers(low, high)

    slave._admission._rng = Repeating()
    assert HandMaster(slave, "b", nonce=2).join().session == first + 1


@pytest.mark.plain
def test_a_sealed_session_without_numbers_left_answers_nothing_and_raises_nothing(monkeypatch):
    monkeypatch.setattr(slave_session, "LAST_SEQUENCE", 6)
    slave = make_slave(sealed=True)
    master = HandMaster(slave, sealed=True).join()
    answers = [master.position(step, 100_000 * step) for step in range(1, 10)]
    assert [len(each) for each in answers] == [1, 1, 1, 1, 0, 0, 0, 0, 0]
    assert max(datagram.sequence for each in answers for datagram in each) < 6
    (context,) = slave.contexts
    assert context.session.received.stray == 5
    slave.close("shutting down", 10**6)
    assert [answer.kind for answer in master.answers()] == [Kind.CLOSE]
    assert context.session.state is SlaveState.CLOSED
