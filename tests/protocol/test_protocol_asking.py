"""How a master asks: HELLO, cookie, HELLO again; how often, and what it does after a refusal."""

import numpy as np
import pytest

from hapticnet.protocol.handshake import FRESH_AFTER_US
from hapticnet.protocol.keys import MasterKey, PrivateKey
from hapticnet.protocol.messages import Close, Code, Welcome, unpack_hello
from hapticnet.protocol.states import Connected, Ended, MasterState, Refused, SessionLost
from hapticnet.protocol.wire import Kind, pack, pack_body
from tests.peers import COOKIE, GRANT, KEY, MASTER, PSK, SESSION, SLAVE, TICKET, HandSlave, events_of
from tests.protocol.test_protocol_master_session import connected, new_session

SECOND = 1_000_000


def hellos(session, from_us, to_us, step_us=1000):
    """Return the times and contents of the HELLOs that a session sends while nobody answers."""
    sent = []
    for now in range(from_us, to_us, step_us):
        session.tick(now)
        sent += [(now, data) for data in session.datagrams_to_send()]
    return sent


def test_hello_is_repeated_at_its_interval_until_it_is_answered(sealed):
    session = new_session(sealed, hello_interval_us=100_000)
    sent = hellos(session, 0, SECOND)
    assert [now for now, _ in sent] == list(range(0, SECOND, 100_000))
    assert len({data for _, data in sent}) == 1, "a repeated HELLO is the same datagram"
    assert not session.streaming


def test_hellos_become_rarer_down_to_the_slowest(sealed):
    session = new_session(sealed, hello_interval_us=100_000, quick_hellos=20, slowest_hello_us=SECOND)
    times = [now for now, _ in hellos(session, 0, 60 * SECOND)]
    gaps = np.diff(times)
    assert (gaps[:19] == 100_000).all()
    assert (np.diff(gaps) >= 0).all()
    assert (gaps[-10:] == SECOND).all()
    assert len(times) < 90


def test_the_cookie_is_sent_back_at_once_and_in_every_repetition(sealed):
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    session.tick(0)
    first = slave.hello()
    assert unpack_hello(first.body).cookie == b""
    slave.cookie(first, 30_000)
    second = slave.hello()
    assert unpack_hello(second.body) == unpack_hello(first.body)._replace(cookie=COOKIE)
    assert second.sequence == first.sequence
    again = hellos(session, 31_000, SECOND)
    assert [now for now, _ in again][:2] == [130_000, 230_000]
    assert {data for _, data in again} == {session._asking._attempt.hello(COOKIE)}


def test_only_the_first_cookie_of_an_attempt_is_answered_at_once_and_the_newest_is_used(sealed):
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    session.tick(0)
    first = slave.hello()
    slave.cookie(first, 10, b"forged by anyone")
    assert unpack_hello(slave.hello().body).cookie == b"forged by anyone"
    for number in range(1000):
        slave.cookie(first, 20 + number, number.to_bytes(16, "big"))
    slave.cookie(first, 2000)
    assert slave.said() == [], "a flood of cookies is not a flood of HELLOs"
    session.tick(110_000)
    assert unpack_hello(slave.hello().body).cookie == COOKIE


def test_a_new_attempt_begins_when_a_cookie_was_not_answered_for_long(sealed):
    """The slave reads each request once; one that was restarted does not know that it did."""
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    session.tick(0)
    slave.cookie(slave.hello(), 0)
    first = unpack_hello(slave.hello().body)
    sent = [(now, unpack_hello(slave._opened(data).body)) for now, data in hellos(session, 1000, 6 * SECOND)]
    assert {hello.nonce for now, hello in sent if now <= FRESH_AFTER_US} == {first.nonce}
    later = [hello for now, hello in sent if now > FRESH_AFTER_US + SECOND]
    assert first.nonce not in {hello.nonce for hello in later}
    assert {hello.cookie for hello in later} == {b""}


def test_only_the_answer_to_our_own_hello_counts(sealed):
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    session.tick(0)
    hello = slave.hello()
    read = unpack_hello(hello.body)
    other = hello._replace(body=hello.body.replace(read.nonce.to_bytes(4, "big"), (read.nonce ^ 1).to_bytes(4, "big")))
    slave.hint(other, 10, "forged", Code.OTHER)
    slave.cookie(other, 10)
    assert session.received.stray == 2
    assert (events_of(session), slave.said()) == ([], [])
    assert session.state is MasterState.CONNECTING


def test_a_welcome_without_a_session_or_with_another_peers_seal_is_malformed(sealed):
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    session.tick(0)
    hello = slave.hello()
    slave.welcome(hello, 10, GRANT._replace(rate_hz=0.0))
    body = pack_body(Welcome(unpack_hello(hello.body).nonce, bytes(range(100))))
    session.receive_datagram(pack(Kind.WELCOME, SESSION, 0, body, slave.version), 20)
    assert session.received.malformed == 2
    assert session.state is MasterState.CONNECTING
    slave.welcome(hello, 30)
    assert events_of(session) == [Connected(GRANT)]


def test_a_second_answer_changes_nothing(sealed):
    session, slave = connected(sealed)
    slave.say(Kind.CLOSE, 1, Close("shutting down"), 0)
    session.tick(100_000)
    hello = slave.hello()
    slave.welcome(hello, 100_000)
    events_of(session)
    stray = session.received.stray
    other = HandSlave(session, sealed=sealed)
    other.welcome(hello, 100_010, GRANT._replace(session=SESSION + 1))
    assert session.received.stray == stray + 1
    assert events_of(session) == []
    session.send_position(100_020, b"")
    assert slave.said()[0].session == SESSION


def test_a_first_refusal_ends_the_master_with_reason_and_code(sealed):
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    session.tick(0)
    slave.refuse(slave.hello(), 10, "no such codec", Code.CODEC)
    assert events_of(session) == [Ended("no such codec", refused=True, code=Code.CODEC)]
    assert session.state is MasterState.CLOSED
    assert hellos(session, 1000, SECOND) == []


def test_a_master_that_had_a_session_asks_again_after_a_refusal_with_back_off(sealed):
    session, slave = connected(sealed, refused_retry_us=SECOND, slowest_retry_us=4 * SECOND)
    slave.say(Kind.CLOSE, 1, Close("shutting down"), 0)
    assert events_of(session) == [SessionLost("the slave closed: shutting down")]
    asked, nonces = [], set()
    for now in range(100_000, 30 * SECOND, 1000):
        session.tick(now)
        for hello in slave.said():
            asked.append(now)
            nonces.add(unpack_hello(hello.body).nonce)
            slave.refuse(hello, now, "all sessions are taken", Code.FULL)
    waits = [event.retry_us for event in events_of(session) if isinstance(event, Refused)]
    assert waits[:5] == [SECOND, 2 * SECOND, 4 * SECOND, 4 * SECOND, 4 * SECOND]
    assert np.diff(asked).tolist() == waits[:-1]
    assert len(nonces) == len(asked), "each is another attempt"
    slave.connect(60 * SECOND)
    assert slave.request.ticket == TICKET
    slave.say(Kind.CLOSE, 1, Close("shutting down"), 60 * SECOND)
    session.tick(61 * SECOND)
    slave.refuse(slave.hello(), 61 * SECOND, "all sessions are taken", Code.FULL)
    assert [event.retry_us for event in events_of(session) if isinstance(event, Refused)] == [SECOND]


def test_a_sealed_welcome_under_another_pre_shared_key_is_not_believed():
    session = new_session(sealed=True)
    session._asking._key = MasterKey(PrivateKey(MASTER.private, PSK), SLAVE.public)
    slave = HandSlave(session, sealed=True)
    session.tick(0)
    slave.welcome(slave.hello(), 10)
    assert session.received.malformed == 1
    assert session.state is MasterState.CONNECTING


def test_a_sealed_request_does_not_show_on_the_wire():
    session = new_session(sealed=True)
    session.tick(0)
    (data,) = session.datagrams_to_send()
    for secret in (b"deadband", b"test", KEY.own.public, KEY.own.private, KEY.peer):
        assert secret not in data


def test_a_grant_does_not_show_its_ticket_in_a_log():
    assert "scene=" in repr(GRANT)
    assert "ticket" not in repr(GRANT)


@pytest.mark.parametrize("fields", [{"announced": True}, {"position_share": 0.25}, {"position_share": 1e-300}])
def test_a_grant_of_what_was_not_asked_for_changes_nothing(fields, sealed):
    session = new_session(sealed)
    slave = HandSlave(session, sealed=sealed)
    slave.connect(grant=GRANT._replace(**fields))
    assert events_of(session) == []
    assert not session.streaming
    assert session.received.malformed == 1
