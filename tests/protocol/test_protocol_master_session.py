"""The master's session, against a slave made by hand."""

import numpy as np
import pytest

from hapticnet.protocol.master_session import (
    Connected,
    Ended,
    ForceArrived,
    HoldConfirmed,
    LinkRecovered,
    LinkStale,
    MasterSession,
    SessionLost,
)
from hapticnet.protocol.messages import (
    Close,
    Code,
    Force,
    Hello,
    Keepalive,
    Refuse,
    Welcome,
    unpack_hello,
    unpack_position,
)
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import MASTER_TRANSITIONS, SLAVE_TRANSITIONS, MasterState, SlaveState
from hapticnet.protocol.wire import Kind, pack, pack_body, unpack

REQUEST = Hello(0, "deadband", {}, 0.05, 0.025, 1.0, 1000.0, 1, "test")
SESSION = 0xABCDEF01


def new_session(**settings):
    return MasterSession(REQUEST, SessionSettings(**settings), np.random.default_rng(1))


def events(session):
    found = []
    while (event := session.next_event()) is not None:
        found.append(event)
    return found


def say(session, kind, sequence, message, now_us, number=SESSION):
    session.receive_datagram(pack(kind, number, sequence, pack_body(message) if message else b""), now_us)


def apply_forces(session):
    for event in events(session):
        if isinstance(event, ForceArrived):
            session.applied(event)


def hello_nonce(session):
    (datagram,) = session.datagrams_to_send()
    return unpack_hello(unpack(datagram).body).nonce


def connected_session(now_us=0, first_sequence=0, **settings):
    session = new_session(first_sequence=first_sequence, **settings)
    session.tick(now_us)
    say(session, Kind.WELCOME, first_sequence, Welcome(hello_nonce(session), 1000.0, 45_000, "scene"), now_us)
    assert [type(event) for event in events(session)] == [Connected]
    return session


def test_hello_is_repeated_at_its_interval_until_it_is_answered():
    session = new_session(hello_interval_us=100_000)
    sent = []
    for now in range(0, 1_000_000, 1000):
        session.tick(now)
        sent += session.datagrams_to_send()
    assert len(sent) == 10
    assert len(set(sent)) == 1, "a repeated HELLO is the same datagram"
    assert not session.streaming


def test_positions_acknowledge_the_newest_force_that_was_applied_and_no_other():
    session = connected_session()
    session.send_position(1000, b"abcd")
    say(session, Kind.FORCE, 1, Force(1000, b"good"), 1500)
    apply_forces(session)
    say(session, Kind.FORCE, 2, Force(1000, b"bad"), 1550)
    session.payload_was_malformed()
    say(session, Kind.KEEPALIVE, 3, Keepalive(1000, 2), 1600)
    assert HoldConfirmed() not in events(session), "what is held is not what the slave sent last"
    session.send_position(2000, b"abcd")
    first, second = (unpack_position(unpack(data).body) for data in session.datagrams_to_send())
    assert first.newest_force is None
    assert second.newest_force == 1


def test_a_force_older_than_the_newest_is_dropped_and_counted():
    session = connected_session()
    say(session, Kind.FORCE, 3, Force(1000, b"new"), 1500)
    apply_forces(session)
    say(session, Kind.FORCE, 2, Force(900, b"old"), 1600)
    say(session, Kind.FORCE, 3, Force(1000, b"new"), 1700)
    assert events(session) == []
    assert (session.received.late, session.received.duplicate, session.received.lost) == (1, 1, 1)


def test_forces_go_on_across_the_wrap_of_sequence_and_time():
    start = 0xFFFF_FFFE
    session = connected_session(now_us=(1 << 32) - 500, first_sequence=start)
    for step in range(1, 5):
        now = (1 << 32) - 500 + 400 * step
        say(session, Kind.FORCE, (start + step) & 0xFFFF_FFFF, Force((now - 100) & 0xFFFF_FFFF, bytes([step])), now)
    arrived = [event for event in events(session) if isinstance(event, ForceArrived)]
    assert [event.payload for event in arrived] == [b"\x01", b"\x02", b"\x03", b"\x04"]
    assert [event.t_us for event in arrived] == [(1 << 32) - 600 + 400 * step for step in range(1, 5)]
    assert session.received.lost == 0
    assert session.round_trip.report()["max_us"] == 100


def test_a_keepalive_confirms_the_hold_only_when_nothing_newer_was_sent():
    session = connected_session()
    say(session, Kind.FORCE, 1, Force(0, b"x"), 100)
    apply_forces(session)
    say(session, Kind.KEEPALIVE, 2, Keepalive(0, 1), 200)
    assert events(session) == [HoldConfirmed()]
    say(session, Kind.KEEPALIVE, 4, Keepalive(0, 3), 300)
    assert events(session) == [], "FORCE 3 was lost: what is held is not confirmed"


def test_silence_makes_the_link_stale_and_anything_heard_brings_it_back():
    session = connected_session(stale_after_us=200_000)
    session.tick(200_000)
    assert events(session) == []
    session.tick(200_001)
    assert events(session) == [LinkStale()]
    assert session.streaming, "positions go on, so that the session can recover"
    say(session, Kind.KEEPALIVE, 1, Keepalive(0, None), 300_000)
    assert events(session)[0] == LinkRecovered()
    assert session.state is MasterState.ESTABLISHED


def test_a_reset_asks_for_a_new_session_at_once_and_old_datagrams_stay_out_of_it():
    session = connected_session()
    session.send_position(500, b"abcd")
    session.datagrams_to_send()
    say(session, Kind.RESET, 1, None, 1000)
    assert [type(event) for event in events(session)] == [SessionLost]
    session.tick(1000)
    nonce = hello_nonce(session)
    say(session, Kind.WELCOME, 0, Welcome(nonce, 1000.0, 45_000, "scene"), 2000, number=0x22222222)
    say(session, Kind.FORCE, 9, Force(0, b"from the old session"), 2100, number=SESSION)
    say(session, Kind.RESET, 9, None, 2200, number=SESSION)
    assert [type(event) for event in events(session)] == [Connected]
    assert session.received.stray == 2
    assert session.state is MasterState.ESTABLISHED


def test_a_reset_counts_only_if_it_answers_a_datagram_that_was_sent():
    session = connected_session(first_sequence=0xFFFF_FFFE)
    for sequence in (0xFFFF_FFFF, 0, 1, 0x8000_0000):
        say(session, Kind.RESET, sequence, None, 1000)
    assert events(session) == []
    session.send_position(500, b"abcd")
    say(session, Kind.RESET, 0xFFFF_FFFF, None, 1000)
    assert [type(event) for event in events(session)] == [SessionLost]


def test_a_force_that_only_a_keepalive_overtook_is_applied():
    session = connected_session()
    say(session, Kind.FORCE, 1, Force(0, b"first"), 100)
    apply_forces(session)
    say(session, Kind.KEEPALIVE, 3, Keepalive(2000, 2), 2100)
    assert events(session) == [], "FORCE 2 is not held yet"
    say(session, Kind.FORCE, 2, Force(1000, b"overtaken"), 2200)
    assert events(session) == [ForceArrived(2, 1000, b"overtaken")]
    say(session, Kind.FORCE, 2, Force(1000, b"overtaken"), 2300)
    assert events(session) == [], "a copy changes nothing"


def test_a_slave_that_failed_is_not_asked_again():
    session = connected_session()
    say(session, Kind.CLOSE, 1, Close("the scene failed", Code.FAILED), 1000)
    assert events(session) == [Ended("the slave closed: the scene failed", refused=False, code=Code.FAILED)]
    assert session.state is MasterState.CLOSED


def test_an_answer_to_an_earlier_hello_or_a_second_answer_changes_nothing():
    session = connected_session()
    say(session, Kind.WELCOME, 0, Welcome(0, 1000.0, 45_000, "scene"), 10, number=0x33333333)
    assert session.received.stray == 1
    session.send_position(0, b"")
    assert unpack(session.datagrams_to_send()[0]).session == SESSION


def test_a_refusal_ends_the_session_with_the_reason():
    session = new_session()
    session.tick(0)
    say(session, Kind.REFUSE, 0, Refuse(hello_nonce(session), "no such codec", Code.CODEC), 10, number=0)
    assert events(session) == [Ended("no such codec", refused=True, code=Code.CODEC)]
    assert session.state is MasterState.CLOSED


def test_only_the_answer_to_our_own_hello_counts():
    session = new_session()
    session.tick(0)
    nonce = hello_nonce(session)
    say(session, Kind.REFUSE, 0, Refuse(nonce ^ 1, "forged"), 10, number=0)
    say(session, Kind.WELCOME, 0, Welcome(nonce, 1000.0, 45_000, "no session in it"), 10, number=0)
    assert events(session) == []
    assert (session.received.stray, session.received.malformed) == (1, 1)
    assert session.state is MasterState.CONNECTING


def test_in_a_new_session_no_force_of_the_old_one_is_acknowledged():
    session = connected_session()
    say(session, Kind.FORCE, 7, Force(0, b"old"), 100)
    apply_forces(session)
    session.send_position(500, b"abcd")
    session.datagrams_to_send()
    say(session, Kind.RESET, 1, None, 1000)
    session.tick(1000)
    say(session, Kind.WELCOME, 0, Welcome(hello_nonce(session), 1000.0, 45_000, "scene"), 2000, number=0x22222222)
    session.send_position(3000, b"abcd")
    assert unpack_position(unpack(session.datagrams_to_send()[0]).body).newest_force is None


@pytest.mark.parametrize("kind", [Kind.CLOSE, Kind.RESET, Kind.FORCE, Kind.KEEPALIVE])
def test_after_the_end_whatever_the_session_still_says_is_stray(kind):
    session = connected_session()
    session.close("done", 0)
    say(session, Kind.CLOSE, 1, Close("as asked"), 1)
    events(session)
    message = {Kind.CLOSE: Close("again"), Kind.FORCE: Force(0, b"x"), Kind.KEEPALIVE: Keepalive(0, None)}.get(kind)
    say(session, kind, 2, message, 2)
    assert session.received.stray == 1
    assert events(session) == []


@pytest.mark.parametrize("jump_us", [-(10**6), -(10**10)])
def test_a_clock_that_goes_back_silences_neither_hello_nor_the_age_limit(jump_us):
    start = 10**11
    session = new_session()
    session.tick(start)
    session.datagrams_to_send()
    session.tick(start + jump_us)
    assert len(session.datagrams_to_send()) == 1
    session = connected_session(now_us=start)
    session.tick(start + jump_us)
    session.tick(start + jump_us + 200_001)
    assert events(session) == [LinkStale()]


def test_close_is_answered_or_given_up():
    for answered in (True, False):
        session = connected_session(close_tries=3, close_interval_us=50_000)
        session.close("done", 0)
        closes = session.datagrams_to_send()
        if answered:
            say(session, Kind.CLOSE, 1, Close("as asked"), 10_000)
        for now in range(0, 400_000, 1000):
            session.tick(now)
            closes += session.datagrams_to_send()
        assert len(closes) == (1 if answered else 3)
        assert session.state is MasterState.CLOSED
        assert events(session)[-1] == Ended("done", refused=False)


def test_when_the_slave_closes_the_master_waits_for_it_to_come_back():
    session = connected_session()
    say(session, Kind.CLOSE, 1, Close("shutting down"), 1000)
    assert events(session) == [SessionLost("the slave closed: shutting down")]
    session.tick(1001)
    assert unpack(session.datagrams_to_send()[0]).kind is Kind.HELLO


@pytest.mark.parametrize("state", ["new", "connected", "closed"])
def test_thirty_thousand_datagrams_of_garbage_are_counted_and_change_nothing(state):
    session = new_session() if state == "new" else connected_session()
    if state == "closed":
        session.close("done", 0)
        say(session, Kind.CLOSE, 1, Close("as asked"), 1)
    before = session.state
    events(session)
    rng = np.random.default_rng(5)
    good = pack(Kind.FORCE, SESSION, 5, pack_body(Force(0, b"abcd")))
    for number in range(30_000):
        if number % 3 == 0:
            data = rng.bytes(int(rng.integers(0, 60)))
        elif number % 3 == 1:
            data = good[: int(rng.integers(0, len(good)))]
        else:
            data = bytes(1201 + number % 100)
        session.receive_datagram(data, 10)
    assert session.received.malformed == 30_000
    assert session.state is before
    assert events(session) == []


def test_every_state_can_be_reached_and_left_but_the_last():
    for table, states, last in (
        (MASTER_TRANSITIONS, MasterState, MasterState.CLOSED),
        (SLAVE_TRANSITIONS, SlaveState, SlaveState.CLOSED),
    ):
        assert {state for state, _ in table} == set(states) - {last}
        assert set(table.values()) | {next(iter(states))} == set(states)
