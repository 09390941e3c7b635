"""The master's session, against a slave made by hand."""

import numpy as np
import pytest

from hapticnet.protocol import master_stream
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import Close, Force, Keepalive, unpack_position
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import (
    MASTER_TRANSITIONS,
    SLAVE_TRANSITIONS,
    Connected,
    Ended,
    ForceArrived,
    HoldConfirmed,
    LinkRecovered,
    LinkStale,
    MasterState,
    SessionLost,
    SlaveState,
)
from hapticnet.protocol.stats import BEHIND_IN_A_ROW, MISORDER
from hapticnet.protocol.wire import Kind, pack, unpack
from tests.peers import GRANT, KEY, REQUEST, SESSION, TICKET, HandSlave, apply_forces, events_of


def new_session(sealed=False, **settings):
    key = KEY if sealed else None
    return MasterSession(REQUEST, SessionSettings(**settings), np.random.default_rng(1), key)


def connected(sealed=False, now_us=0, **settings):
    """Return a session with a position of time `now_us` under way, and the slave made by hand."""
    session = new_session(sealed, **settings)
    slave = HandSlave(session, sealed=sealed).connect(now_us, first_sequence=settings.get("first_sequence", 0))
    assert events_of(session) == [Connected(GRANT)]
    send_position(session, slave, now_us)
    return session, slave


def send_position(session, slave, t_us):
    session.send_position(t_us, b"abcd")
    (datagram,) = slave.said()
    assert datagram.kind is Kind.POSITION
    return unpack_position(datagram.body)


def test_positions_acknowledge_the_newest_force_that_was_applied_and_no_other(sealed):
    session, slave = connected(sealed)
    slave.say(Kind.FORCE, 1, Force(0, b"good"), 1500)
    apply_forces(session)
    slave.say(Kind.FORCE, 2, Force(0, b"bad"), 1550)
    session.payload_was_malformed()
    slave.say(Kind.KEEPALIVE, 3, Keepalive(0, 2), 1600)
    assert not any(isinstance(event, HoldConfirmed) for event in events_of(session)), "not what the slave sent last"
    assert send_position(session, slave, 2000) == (2000, 1, b"abcd", None, 0)


def test_a_keepalive_that_confirms_the_newest_force_is_acknowledged_in_its_place(sealed):
    session, slave = connected(sealed)
    slave.say(Kind.FORCE, 1, Force(0, b"good"), 1500)
    apply_forces(session)
    slave.say(Kind.KEEPALIVE, 2, Keepalive(0, 1), 1600)
    assert events_of(session) == [HoldConfirmed(0)]
    assert send_position(session, slave, 2000).newest == 2
    slave.say(Kind.KEEPALIVE, 4, Keepalive(0, 3), 2100)
    assert events_of(session) == [], "FORCE 3 was lost: what is held is not confirmed"
    assert send_position(session, slave, 3000).newest == 2, "it names a force that did not arrive"


def test_positions_report_loss_only_while_there_is_some(sealed):
    session, slave = connected(sealed)
    sequence, reports = 0, []
    for tick in range(4000):
        sequence += 2 if 1000 <= tick < 1400 else 1
        slave.say(Kind.KEEPALIVE, sequence, Keepalive(1000 * tick, None), 1000 * tick)
        reports.append(send_position(session, slave, 1000 * tick).loss)
    assert not any(reports[:1000])
    assert sum(report is not None for report in reports) < len(reports) / 16 + 1
    assert max(report.share for report in reports if report) == pytest.approx(0.36, abs=0.1)
    assert max(report.again for report in reports[1300:1400] if report) < 0.1, "no two in a row"


def test_a_force_older_than_the_newest_is_dropped_and_counted(sealed):
    session, slave = connected(sealed)
    send_position(session, slave, 1000)
    slave.say(Kind.FORCE, 3, Force(1000, b"new"), 1500)
    apply_forces(session)
    slave.say(Kind.FORCE, 2, Force(900, b"old"), 1600)
    slave.say(Kind.FORCE, 3, Force(1000, b"new"), 1700)
    assert events_of(session) == []
    assert (session.received.late, session.received.duplicate, session.received.lost) == (1, 1, 1)


@pytest.mark.plain
def test_the_session_of_a_grant_counts_and_not_that_of_its_frame(sealed):
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    taken = session.receive_datagram

    def changed(data, now_us):
        frame = unpack(data)
        taken(pack(*frame[1:2], 7, *frame[3:], frame.version) if frame.kind is Kind.WELCOME else data, now_us)

    session.receive_datagram = changed
    slave.connect()
    send_position(session, slave, 0)
    slave.say(Kind.FORCE, 1, Force(0, b"f"), 0)
    assert any(isinstance(event, ForceArrived) for event in apply_forces(session))


def test_silence_makes_the_link_stale_and_a_fresh_datagram_brings_it_back(sealed):
    session, slave = connected(sealed, stale_after_us=200_000)
    session.tick(200_000)
    assert events_of(session) == []
    session.tick(200_001)
    assert events_of(session) == [LinkStale()]
    assert session.streaming, "positions go on, so that the session can recover"
    slave.say(Kind.KEEPALIVE, 1, Keepalive(0, None), 300_000)
    assert events_of(session)[0] == LinkRecovered()
    assert session.state is MasterState.ESTABLISHED


def test_positions_become_rarer_while_the_link_is_stale_and_are_all_sent_again_afterwards(sealed):
    session, slave = connected(sealed, stale_interval_us=50_000)
    sent = []
    for now in range(1000, 1_000_000, 1000):
        session.tick(now)
        session.send_position(now, b"abcd")
        sent += [now for datagram in slave.said() if datagram.kind is Kind.POSITION]
    assert sent[:200] == list(range(1000, 201_000, 1000))
    gaps = np.diff(sent[200:])
    assert (np.diff(gaps) >= 0).all()
    assert gaps[-1] == 50_000
    assert len(gaps) < 40
    slave.say(Kind.KEEPALIVE, 1, Keepalive(sent[-1], None), 1_000_000)
    for now in range(1_000_000, 1_010_000, 1000):
        send_position(session, slave, now)


def test_a_force_that_only_a_keepalive_overtook_is_applied(sealed):
    session, slave = connected(sealed)
    slave.say(Kind.FORCE, 1, Force(0, b"first"), 100)
    apply_forces(session)
    send_position(session, slave, 2000)
    slave.say(Kind.KEEPALIVE, 3, Keepalive(2000, 2), 2100)
    assert events_of(session) == [], "FORCE 2 is not held yet"
    slave.say(Kind.FORCE, 2, Force(1000, b"overtaken"), 2200)
    assert events_of(session) == [ForceArrived(2, 1000, b"overtaken")]
    slave.say(Kind.FORCE, 2, Force(1000, b"overtaken"), 2300)
    assert events_of(session) == [], "a copy changes nothing"


@pytest.mark.parametrize("ahead", [2, 101, 200, 3000, (1 << 31) - 1])
def test_one_forged_number_does_not_deafen_an_open_session_for_long(ahead):
    session, slave = connected()
    send_position(session, slave, 1_000_000)
    slave.say(Kind.FORCE, 1, Force(0, b"true"), 1000)
    slave.say(Kind.FORCE, 1 + ahead, Force(0, b"forged"), 1500)
    apply_forces(session)
    deaf = 0
    for step in range(2, 200):
        slave.say(Kind.FORCE, step, Force(1000 * step, b"true"), 1000 * step)
        if not any(isinstance(event, ForceArrived) for event in apply_forces(session)):
            deaf = step - 1
    near = ahead <= MISORDER + BEHIND_IN_A_ROW  # may be the disorder of a network
    assert deaf <= (ahead if near else BEHIND_IN_A_ROW)


def test_when_the_slave_closes_the_master_asks_at_once_to_go_on_with_its_scene(sealed):
    session, slave = connected(sealed)
    slave.say(Kind.CLOSE, 1, Close("shutting down"), 1000)
    assert events_of(session) == [SessionLost("the slave closed: shutting down")]
    assert not session.streaming
    session.tick(100_000)
    hello = slave.hello()
    slave.cookie(hello, 100_000)
    slave.welcome(slave.hello(), 100_000, GRANT._replace(session=SESSION + 1))
    assert slave.request == REQUEST._replace(ticket=TICKET, clock_us=100_000)
    assert events_of(session) == [Connected(GRANT._replace(session=SESSION + 1))]


def test_a_close_from_before_the_newest_datagram_ends_no_session_of_a_master(sealed):
    session, slave = connected(sealed)
    slave.say(Kind.KEEPALIVE, 9, Keepalive(0, None), 10)
    events_of(session)
    slave.say(Kind.CLOSE, 8, Close("of the past"), 20)
    assert (events_of(session), session.state) == ([], MasterState.ESTABLISHED)


def test_in_a_new_session_no_force_of_the_old_one_is_acknowledged_or_applied(sealed):
    session, slave = connected(sealed)
    slave.say(Kind.FORCE, 7, Force(0, b"old"), 100)
    apply_forces(session)
    old = slave.say(Kind.CLOSE, 8, Close("shutting down"), 1000)
    slave.connect(100_000, GRANT._replace(session=SESSION + 1))
    session.receive_datagram(old, 100_100)
    session.receive_datagram(pack(Kind.RESET, SESSION, 1, b"", slave.version), 100_200)
    assert session.received.stray == 2
    assert session.streaming
    assert send_position(session, slave, 101_000).newest is None


@pytest.mark.parametrize("kind", [Kind.CLOSE, Kind.RESET, Kind.FORCE, Kind.KEEPALIVE])
def test_after_the_end_whatever_the_session_still_says_is_stray(kind, sealed):
    session, slave = connected(sealed)
    session.close("done", 0)
    slave.say(Kind.CLOSE, 1, Close("as asked"), 1)
    events_of(session)
    message = {Kind.CLOSE: Close("again"), Kind.FORCE: Force(0, b"x"), Kind.KEEPALIVE: Keepalive(0, None)}.get(kind)
    slave.say(kind, 2, message or (), 2)
    assert session.received.stray == 1
    assert events_of(session) == []


@pytest.mark.parametrize("jump_us", [-(10**6), -(10**10)])
def test_a_clock_that_goes_back_silences_neither_hello_nor_the_age_limit(jump_us):
    start = 10**11
    session = new_session()
    session.tick(start)
    session.datagrams_to_send()
    session.tick(start + jump_us)
    assert len(session.datagrams_to_send()) == 1
    session, _ = connected(now_us=start)
    session.tick(start + jump_us)
    session.tick(start + jump_us + 200_001)
    assert events_of(session) == [LinkStale()]


@pytest.mark.parametrize("answer", ["close", "reset", "nothing"])
def test_close_is_answered_or_given_up(answer, sealed):
    session, slave = connected(sealed, close_tries=3, close_interval_us=50_000)
    session.close("done", 0)
    closes = slave.said()
    if answer == "close":
        slave.say(Kind.CLOSE, 1, Close("as asked"), 10_000)
    elif answer == "reset":
        slave.reset(closes[0].sequence, 10_000)
    for now in range(0, 400_000, 1000):
        session.tick(now)
        closes += slave.said()
    assert [datagram.kind for datagram in closes] == [Kind.CLOSE] * (3 if answer == "nothing" else 1)
    assert session.state is MasterState.CLOSED
    assert events_of(session)[-1] == Ended("done", refused=False)


def test_a_master_that_closes_before_it_is_connected_sends_nothing_more(sealed):
    session = new_session(sealed)
    session.tick(0)
    session.datagrams_to_send()
    session.close("never mind", 10)
    assert events_of(session) == [Ended("never mind", refused=False)]
    session.tick(1_000_000)
    assert session.datagrams_to_send() == []


@pytest.mark.plain
def test_a_sealed_master_without_numbers_left_sends_nothing_under_the_old_key(monkeypatch):
    last = master_stream.RECENT + 5
    monkeypatch.setattr(master_stream, "LAST_SEQUENCE", last)
    session, slave = connected(sealed=True)
    session._stream.sequence = last - 1
    for now in range(1000, 9000, 1000):
        session.send_position(now, b"abcd")
    assert [datagram.sequence for datagram in slave.said()] == [
        master_stream.LAST_SEQUENCE - 1,
        master_stream.LAST_SEQUENCE,
    ]
    session.close("done", 9000)
    assert slave.said() == []
    for now in range(9000, 1_000_000, 1000):
        session.tick(now)
    assert session.state is MasterState.CLOSED


def test_every_state_can_be_reached_and_left_but_the_last():
    for table, states, last in (
        (MASTER_TRANSITIONS, MasterState, MasterState.CLOSED),
        (SLAVE_TRANSITIONS, SlaveState, SlaveState.CLOSED),
    ):
        assert {state for state, _ in table} == set(states) - {last}
        assert set(table.values()) | {next(iter(states))} == set(states)
