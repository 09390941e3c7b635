"""How a master asks: HELLO, cookie, HELLO again; how often, and what it does after a refusal."""

import numpy as np
import pytest

from hapticnet.protocol.handshake import FRESH_AFTER_US
from hapticnet.protocol.messages import Close, Code, Cookie, Keepalive, Refuse, Welcome, unpack_hello
from hapticnet.protocol.states import Connected, Ended, Hinted, LinkStale, MasterState, Refused, SessionLost
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, pack_body
from tests.peers import COOKIE, GRANT, KEY, SESSION, TICKET, HandSlave, events_of
from tests.protocol.test_protocol_master_session import connected, new_session, send_position

SECOND = 1_000_000


def asking(sealed, **settings):
    """Return a session that asks for the first time, its slave made by hand, and the HELLO."""
    session = new_session(sealed, **settings)
    slave = HandSlave(session, sealed=sealed)
    session.tick(0)
    return session, slave, slave.hello()


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
    session, slave, first = asking(sealed)
    assert unpack_hello(first.body).cookie == b""
    slave.cookie(first, 30_000)
    second = slave.hello()
    assert unpack_hello(second.body) == unpack_hello(first.body)._replace(cookie=COOKIE)
    assert second.sequence == first.sequence
    again = hellos(session, 31_000, SECOND)
    assert [now for now, _ in again][:2] == [130_000, 230_000]
    assert {data for _, data in again} == {session._asking._attempt.hello(COOKIE)}


def test_only_the_first_cookie_of_an_attempt_is_answered_at_once_and_the_newest_is_used(sealed):
    session, slave, first = asking(sealed)
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
    session, slave, hello = asking(sealed)
    slave.cookie(hello, 0)
    first = unpack_hello(slave.hello().body)
    sent = [(now, unpack_hello(slave._opened(data).body)) for now, data in hellos(session, 1000, 6 * SECOND)]
    assert {hello.nonce for now, hello in sent if now <= FRESH_AFTER_US} == {first.nonce}
    later = [hello for now, hello in sent if now > FRESH_AFTER_US + SECOND]
    assert first.nonce not in {hello.nonce for hello in later}
    assert {hello.cookie for hello in later} == {b""}


def test_only_the_answer_to_our_own_hello_counts(sealed):
    session, slave, hello = asking(sealed)
    read = unpack_hello(hello.body)
    other = hello._replace(body=hello.body.replace(read.nonce.to_bytes(4, "big"), (read.nonce ^ 1).to_bytes(4, "big")))
    slave.hint(other, 10, "forged", Code.OTHER)
    slave.cookie(other, 10)
    assert session.received.stray == 2
    assert (events_of(session), slave.said()) == ([], [])
    assert session.state is MasterState.CONNECTING


@pytest.mark.parametrize("fields", [{"announced": True}, {"position_share": 0.25}, {"position_share": 1e-300}])
def test_a_grant_of_what_was_not_asked_for_changes_nothing(fields, sealed):
    session = new_session(sealed)
    HandSlave(session, sealed=sealed).connect(grant=GRANT._replace(**fields))
    assert (events_of(session), session.streaming, session.received.malformed) == ([], False, 1)


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
    session, slave, hello = asking(sealed)
    slave.refuse(hello, 10, "no such codec", Code.CODEC)
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


def test_a_master_with_a_key_takes_no_open_session():
    session, slave, hello = asking(sealed=True)
    nonce = unpack_hello(hello.body).nonce
    session.receive_datagram(pack(Kind.COOKIE, 0, 0, pack_body(Cookie(nonce, bytes(16))), OPEN), 0)
    for version in (OPEN, SEALED):
        body = pack_body(Welcome(nonce, pack_body(GRANT)))
        session.receive_datagram(pack(Kind.WELCOME, SESSION, 0, body, version), 0)
    assert session.state is MasterState.CONNECTING
    assert {datagram.version for datagram in slave.said()} == {SEALED}
    slave.welcome(hello, 0)
    assert events_of(session) == [Connected(GRANT)]


def test_a_sealed_request_does_not_show_on_the_wire():
    session = new_session(sealed=True)
    session.tick(0)
    (data,) = session.datagrams_to_send()
    for secret in (b"deadband", b"test", KEY.own.public, KEY.own.private, KEY.peer):
        assert secret not in data


def test_a_grant_does_not_show_its_ticket_in_a_log():
    assert "scene=" in repr(GRANT)
    assert "ticket" not in repr(GRANT)


SILENT_US = 45_000 + 10_000


"""A keepalive interval and the margin: longer silence shows that a RESET may be true."""


def forgeries(session_number, nonce, version):
    """Return one of each datagram that anybody can make who knows the numbers of a session."""
    return [
        pack(Kind.RESET, session_number, 1, b"", version),
        pack(Kind.REFUSE, 0, 0, pack_body(Refuse(nonce, "forged", Code.KEY)), version),
        pack(Kind.COOKIE, 0, 0, pack_body(Cookie(nonce, bytes(16))), version),
        pack(Kind.WELCOME, 7, 0, pack_body(Welcome(nonce, b"forged")), version),
        pack(Kind.WELCOME, 0, 0, pack_body(Welcome(nonce, pack_body(GRANT._replace(session=0)))), version),
    ]


def flow(session, slave, from_us, to_us, attack=lambda _: ()):
    """Let positions and keepalives flow; return the HELLOs sent and the events meanwhile."""
    hellos = []
    for now in range(from_us, to_us, 1000):
        for data in attack(now):
            session.receive_datagram(data, now)
        session.tick(now)
        session.send_position(now, b"abcd")
        hellos += [datagram for datagram in slave.said() if datagram.kind is Kind.HELLO]
        if now % 45_000 == 0:
            slave.say(Kind.KEEPALIVE, now // 45_000, Keepalive(now, None), now)
    return hellos, [event for event in events_of(session) if not type(event).__name__.startswith("Hold")]


@pytest.mark.parametrize("version", [OPEN, SEALED])
def test_forged_answers_cost_an_established_session_nothing(sealed, version):
    session, slave = connected(sealed)
    data = forgeries(SESSION, 1, version)
    assert flow(session, slave, 45_000, 3_000_000, lambda _: data) == ([], [])
    assert session.state is MasterState.ESTABLISHED


def heard_at(now_us, sealed):
    """Return a session whose slave was last heard at `now_us`, and the slave."""
    session, slave = connected(sealed)
    send_position(session, slave, now_us - 1000)
    slave.say(Kind.KEEPALIVE, 1, Keepalive(now_us - 1000, None), now_us)
    events_of(session)
    return session, slave


def test_a_reset_is_believed_only_after_a_silence_and_then_the_old_session_goes_on(sealed):
    session, slave = heard_at(150_000, sealed)
    slave.reset(1, 151_000)
    hello_at = None
    for now in range(151_000, 300_000, 1000):
        session.tick(now)
        session.send_position(now, b"abcd")
        if hello_at is None and any(datagram.kind is Kind.HELLO for datagram in slave.said()):
            hello_at = now
    assert hello_at == 150_000 + SILENT_US + 1000
    assert session.streaming
    assert events_of(session) == []
    slave.said()
    slave.say(Kind.KEEPALIVE, 2, Keepalive(299_000, None), 300_000)
    assert flow(session, slave, 315_000, 1_000_000) == ([], []), "one fresh datagram refutes a RESET"


def test_after_a_believed_reset_at_most_one_hello_is_sent_per_interval(sealed):
    session, slave = heard_at(150_000, sealed)
    hellos = []
    for now in range(151_000, 350_000, 1000):
        slave.reset(1, now)
        session.tick(now)
        hellos += [now for datagram in slave.said() if datagram.kind is Kind.HELLO]
    assert hellos == [206_000, 306_000]


def in_doubt(sealed):
    """Return a session that asks for another one at 206 ms, its slave, and the HELLO."""
    session, slave = heard_at(150_000, sealed)
    slave.reset(1, 151_000)
    session.tick(206_000)
    return session, slave, slave.hello()


def test_a_new_session_after_a_true_reset_goes_on_with_the_scene(sealed):
    session, slave, hello = in_doubt(sealed)
    slave.cookie(hello, 206_000)
    hello = slave.hello()
    send_position(session, slave, 206_500)
    slave.welcome(hello, 207_000, GRANT._replace(session=SESSION + 1, resumed=True))
    assert slave.request.ticket == TICKET
    assert events_of(session) == [Connected(GRANT._replace(session=SESSION + 1, resumed=True))]
    session.tick(400_000)
    assert slave.said() == []


def test_a_reset_counts_only_if_it_answers_a_datagram_that_was_sent():
    session, slave = connected(first_sequence=0xFFFF_FFFE)
    for sequence in (0, 1, 2, 0x8000_0000, 0xFFFF_FFFF - (1 << 15)):
        slave.reset(sequence, 1000)
    session.tick(100_000)
    assert slave.said() == []
    assert session.received.stray == 5
    slave.reset(0xFFFF_FFFF, 100_000)
    session.tick(100_001)
    assert slave.hello()


def test_forged_answers_while_a_session_is_asked_for_beside_end_nothing(sealed):
    session, slave, hello = in_doubt(sealed)
    nonce = unpack_hello(hello.body).nonce
    for data in forgeries(SESSION, nonce, slave.version) + forgeries(SESSION, nonce ^ 1, slave.version):
        session.receive_datagram(data, 206_100)
    assert session.streaming
    assert not any(isinstance(event, Connected) for event in events_of(session))
    slave.said()
    send_position(session, slave, 207_000)
    slave.say(Kind.KEEPALIVE, 2, Keepalive(207_000, None), 208_000)
    assert flow(session, slave, 225_000, 600_000) == ([], [])


def test_a_refusal_without_a_seal_is_only_told_once_for_each_attempt(sealed):
    session, slave, hello = in_doubt(sealed)
    for _ in range(100):
        slave.hint(hello, 206_100, "go away", Code.KEY)
    told = events_of(session)
    assert len(told) == 1
    assert type(told[0]) is (Hinted if sealed else Refused)
    assert session.streaming


def test_a_refusal_without_a_seal_ends_no_sealed_master_that_connects_for_the_first_time():
    session, slave, hello = asking(sealed=True)
    slave.hint(hello, 10, "this slave has no key", Code.KEY)
    assert events_of(session) == [Hinted("this slave has no key")]
    slave.welcome(hello, 20)
    assert events_of(session) == [Connected(GRANT)]


def test_a_stale_link_is_asked_for_again_beside_the_old_session_which_may_recover(sealed):
    session, slave = connected(sealed, stale_after_us=200_000, ask_again_us=1_000_000)
    hellos = []
    for now in range(0, 2_000_000, 1000):
        session.tick(now)
        session.send_position(now, b"abcd")
        hellos += [now for datagram in slave.said() if datagram.kind is Kind.HELLO]
    assert np.isclose(hellos[0], 1_200_000, atol=2000)
    assert events_of(session) == [LinkStale()]
    slave.say(Kind.KEEPALIVE, 1, Keepalive(1_900_000, None), 2_000_000)
    assert session.state is MasterState.ESTABLISHED
    session.tick(2_150_000)
    assert slave.said() == []


@pytest.mark.parametrize("state", ["connecting", "closing", "closed"])
def test_forged_answers_do_nothing_in_the_other_states(sealed, state):
    session, slave = connected(sealed)
    if state == "connecting":
        slave.say(Kind.CLOSE, 1, Close("shutting down"), 0)
    else:
        session.close("done", 0)
        if state == "closed":
            for now in range(0, 1_000_000, 50_000):
                session.tick(now)
    slave.said()
    before = session.state
    events_of(session)
    for data in forgeries(SESSION + 1, 1, slave.version) + forgeries(0, 0, slave.version):
        session.receive_datagram(data, 1_000_000)
    assert session.state is before
    assert events_of(session) == []
