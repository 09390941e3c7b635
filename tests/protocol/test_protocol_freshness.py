"""Only answers to recent positions count: by the master's own clock, whatever delays or repeats them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.protocol.master_stream import Freshness
from hapticnet.protocol.messages import Force, Keepalive
from hapticnet.protocol.states import ForceArrived, HoldConfirmed, LinkRecovered, LinkStale, MasterState
from hapticnet.protocol.wire import Kind, wrap
from tests.peers import apply_forces, events_of
from tests.protocol.test_protocol_master_session import connected, send_position

MAX_AGE_US = 1_000_000


@given(st.integers(0, 1 << 50), st.integers(-(10**7), 10**7))
def test_an_answer_is_fresh_if_its_position_was_sent_and_is_no_older_than_the_limit(sent_us, age_us):
    fresh = Freshness(MAX_AGE_US)
    fresh.newest_t_us = sent_us
    now_us = sent_us + age_us
    answered = fresh.fresh_t_us(wrap(sent_us), now_us, is_new=True)
    assert answered == (sent_us if age_us <= MAX_AGE_US else None)
    assert fresh.too_old_us == (None if age_us <= MAX_AGE_US else age_us)
    assert fresh.fresh_t_us(wrap(sent_us + 1), now_us, is_new=True) is None, "no such position was sent"
    assert fresh.too_old_us == (None if age_us <= MAX_AGE_US else age_us), "and its age means nothing"


def test_the_age_told_is_that_of_the_least_old_since_the_last_fresh_one():
    fresh = Freshness(MAX_AGE_US)
    fresh.newest_t_us = 0
    for now_us in (3_000_000, 2_000_000, 4_000_000):
        fresh.fresh_t_us(0, now_us, is_new=True)
    fresh.fresh_t_us(0, 1_500_000, is_new=False)
    assert fresh.too_old_us == 2_000_000
    fresh.heard(4_000_000)
    assert fresh.too_old_us is None


def test_a_clock_that_goes_back_does_not_shorten_a_silence():
    fresh = Freshness(MAX_AGE_US)
    fresh.heard(10_000_000)
    assert fresh.silent_us(4_000_000) == 0
    assert fresh.silent_us(5_000_000) == 1_000_000


@pytest.mark.parametrize("kind", [Kind.FORCE, Kind.KEEPALIVE])
def test_an_answer_to_an_old_position_or_to_none_is_counted_and_nothing_else(sealed, kind):
    session, slave = connected(sealed, now_us=10_000_000)
    for t_us in range(10_000_000, 13_000_000, 1000):
        session.send_position(t_us, b"abcd")
    now_us = 13_000_000

    def answer(sequence, t_us):
        message = Force(t_us, b"abcd") if kind is Kind.FORCE else Keepalive(t_us, None)
        slave.say(kind, sequence, message, now_us)
        return events_of(session)

    for sequence, t_us in enumerate((11_999_999, 10_000_000, 0, 12_999_001, 13_000_000, 99_000_000), start=1):
        assert answer(sequence, t_us) == []
        assert session.received.too_old == sequence
    assert session.round_trip.count == 0
    (event,) = answer(7, 12_000_000)
    assert event == (ForceArrived(7, 12_000_000, b"abcd") if kind is Kind.FORCE else HoldConfirmed(12_000_000))
    assert session.received.too_old == 6


def test_old_answers_are_no_sign_of_life_and_the_stale_link_names_their_age(sealed):
    """A slave that wakes up, or a network that held everything back: the forces of 1.5 s ago, at their own pace."""
    session, slave = connected(sealed)
    found = []
    for now_us in range(0, 3_000_000, 1000):
        session.tick(now_us)
        session.send_position(now_us, b"abcd")
        if now_us >= 1_600_000:
            slave.say(Kind.FORCE, now_us // 1000, Force(now_us - 1_500_000, b"abcd"), now_us)
        found += [(now_us, event) for event in apply_forces(session)]
    assert found == [(201_000, LinkStale(None)), (1_600_000, LinkStale(1_500_000))]
    assert session.state is MasterState.STALE
    assert session.received.too_old == 1400


def test_a_link_that_is_too_slow_is_stale_with_the_age_of_its_least_old_answer(sealed):
    start = 10_000_000
    session, slave = connected(sealed, now_us=start)
    for step, age_us in enumerate((1_900_000, 1_300_000, 1_700_000), start=1):
        slave.say(Kind.KEEPALIVE, step, Keepalive(start + 100_000 - age_us, None), start + 100_000)
    session.tick(start + 200_001)
    assert events_of(session) == [LinkStale(1_300_000)]
    slave.say(Kind.KEEPALIVE, 4, Keepalive(start, None), start + 310_000)
    assert events_of(session)[0] == LinkRecovered()
    session.tick(start + 600_000)
    assert events_of(session) == [LinkStale(None)], "nothing arrived since"


def test_a_late_datagram_is_no_sign_of_life_though_its_force_is_news(sealed):
    session, slave = connected(sealed)
    send_position(session, slave, 150_000)
    slave.say(Kind.KEEPALIVE, 5, Keepalive(0, 4), 1000)
    session.tick(150_000)
    slave.say(Kind.FORCE, 4, Force(140_000, b"late"), 190_000)
    assert apply_forces(session) == [ForceArrived(4, 140_000, b"late")]
    slave.say(Kind.KEEPALIVE, 3, Keepalive(150_000, None), 195_000)
    session.tick(201_001)
    assert events_of(session) == [LinkStale()]
    slave.say(Kind.FORCE, 2, Force(150_000, b"later"), 202_000)
    assert session.state is MasterState.STALE


def test_a_slower_link_is_used_where_the_limit_allows_it(sealed):
    session, slave = connected(sealed, max_age_us=3_000_000)
    slave.say(Kind.FORCE, 1, Force(0, b"abcd"), 2_900_000)
    assert events_of(session) == [ForceArrived(1, 0, b"abcd")]
