"""What is not authenticated costs a master nothing while data flow, in every state of its session."""

import numpy as np
import pytest

from hapticnet.protocol.messages import Close, Code, Cookie, Keepalive, Refuse, Welcome, unpack_hello
from hapticnet.protocol.states import Connected, Hinted, LinkStale, MasterState, Refused
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, pack_body
from tests.peers import GRANT, SESSION, TICKET, HandSlave, events_of
from tests.protocol.test_protocol_master_session import connected, new_session, send_position

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
    session = new_session(sealed=True)
    slave = HandSlave(session, sealed=True)
    session.tick(0)
    hello = slave.hello()
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
