"""The slave and what strangers, liars and restarts do to it."""

import numpy as np
import pytest

from hapticnet.codec.registry import CODECS
from hapticnet.node.slave import MasterLeft
from hapticnet.protocol.messages import (
    HELLO_BYTES,
    REASON_BYTES,
    Close,
    Code,
    Hello,
    Position,
    clipped,
    pack_hello,
    unpack_refuse,
    unpack_welcome,
)
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.wire import VERSION, Kind, pack, pack_body, unpack
from tests.conftest import make_slave

HELLO = Hello(1, "deadband", {}, 0.05, 0.025, 1.0, 1000.0, 1, "test")


def answer(slave):
    ((data, _),) = slave.datagrams_to_send()
    return unpack(data)


def join(slave, address="a", now_us=0, nonce=1):
    slave.receive_datagram(pack_hello(HELLO._replace(nonce=nonce), 0), address, now_us)
    return answer(slave).session


def send_position(slave, session, sequence, now_us, position_m=0.0, address="a", ack=None):
    body = pack_body(Position(now_us & 0xFFFFFFFF, ack, np.array(position_m, ">f4").tobytes()))
    slave.receive_datagram(pack(Kind.POSITION, session, sequence, body), address, now_us)
    return [unpack(data) for data, _ in slave.datagrams_to_send()]


def test_no_answer_to_a_stranger_is_larger_than_what_it_answers():
    slave = make_slave()
    rng = np.random.default_rng(1)
    questions = [
        pack_hello(HELLO, 0),
        pack_hello(HELLO._replace(codec="x" * 64, nonce=2), 0),
        pack_hello(HELLO._replace(axes=3, nonce=3), 0),
        pack(Kind.POSITION, 99, 0, b""),
        pack(Kind.CLOSE, 99, 0, b""),
        pack_body((VERSION + 1, Kind.HELLO, 0, 0, pack_body((5, "?" * 400)))),
        *(rng.bytes(int(size)) for size in rng.integers(0, 1500, 2000)),
    ]
    answered = 0
    for number, question in enumerate(questions):
        slave.receive_datagram(question, number, 0)
        for data, address in slave.datagrams_to_send():
            assert address == number
            assert len(data) <= len(question)
            answered += 1
    assert answered == 6


def test_a_short_hello_is_malformed_and_gets_no_answer():
    slave = make_slave()
    bare = pack(Kind.HELLO, 0, 0, pack_body((*HELLO, b"")))
    assert len(bare) < HELLO_BYTES
    slave.receive_datagram(bare, "a", 0)
    assert slave.datagrams_to_send() == []
    assert slave.strangers.malformed == 1


def test_a_hello_of_another_version_is_told_which_one_is_spoken_here():
    slave = make_slave()
    slave.receive_datagram(pack_body((VERSION + 1, Kind.HELLO, 0, 0, pack_body((5, "?" * 400)))), "a", 0)
    refusal = answer(slave)
    assert refusal.kind is Kind.REFUSE
    assert unpack_refuse(refusal.body) == (5, f"this slave speaks protocol version {VERSION} only", Code.VERSION)


def test_the_same_hello_gets_the_same_welcome_and_another_one_a_new_session():
    slave = make_slave()
    slave.receive_datagram(pack_hello(HELLO, 0), "a", 0)
    slave.receive_datagram(pack_hello(HELLO, 0), "a", 10)
    (first, _), (second, _) = slave.datagrams_to_send()
    assert first == second
    assert unpack_welcome(unpack(first).body).nonce == 1
    other = join(slave, nonce=2)
    assert other != unpack(first).session
    assert len(slave.stations) == 1


@pytest.mark.parametrize(
    ("change", "code", "reason"),
    [
        ({"codec": "mp3"}, Code.CODEC, clipped(f"unknown codec 'mp3'; there are: {', '.join(CODECS)}", REASON_BYTES)),
        ({"axes": 3}, Code.AXES, "3 axes asked for; scene 'paper:1' has 1"),
        ({"weber_fraction": -1.0}, Code.PARAMETER, "Weber fraction is -1.0; it must be 0 or between 1e-12 and 1"),
        (
            {"parameters": {"bitrate": 1.0}},
            Code.PARAMETER,
            "codec 'deadband' has no parameter 'bitrate'; it has: step_n",
        ),
    ],
)
def test_what_cannot_be_served_is_refused_in_words_and_with_a_code(change, code, reason):
    slave = make_slave()
    slave.receive_datagram(pack_hello(HELLO._replace(**change), 0), "a", 0)
    assert unpack_refuse(answer(slave).body)[1:] == (reason, code)
    assert slave.stations == ()


def test_a_position_of_an_unknown_session_or_from_another_address_is_answered_with_reset():
    slave = make_slave()
    session = join(slave)
    assert [d.kind for d in send_position(slave, session ^ 1, 1, 0)] == [Kind.RESET]
    assert [d.kind for d in send_position(slave, session, 1, 0, address="thief")] == [Kind.RESET]
    assert slave.stations[0].steps == 0


def test_a_position_older_than_the_newest_does_not_move_the_scene():
    slave = make_slave()
    session = join(slave)
    send_position(slave, session, 5, 1000, position_m=0.025)
    force = slave.stations[0].scene.force_n
    assert force > 0
    assert send_position(slave, session, 4, 2000, position_m=0.0) == []
    assert slave.stations[0].scene.force_n == force
    assert slave.stations[0].session.received.late == 1


@pytest.mark.parametrize("payload", [b"", b"123", bytes.fromhex("7fc00000"), bytes.fromhex("7f800000"), bytes(12)])
def test_a_position_that_is_not_finite_or_not_of_the_right_size_is_malformed_and_moves_nothing(payload):
    slave = make_slave()
    session = join(slave)
    send_position(slave, session, 1, 1000, position_m=0.025)
    body = pack_body(Position(2000, None, payload))
    slave.receive_datagram(pack(Kind.POSITION, session, 2, body), "a", 2000)
    received = slave.stations[0].session.received
    assert received.malformed == 1
    assert received.packets == 3, "HELLO and two POSITIONs, each counted once"
    assert slave.stations[0].steps == 1
    assert [d.kind for d in send_position(slave, session, 3, 3000, position_m=0.028)] == [Kind.FORCE]


def test_keepalives_fill_silence_only_while_positions_arrive():
    slave = make_slave(session=SessionSettings(keepalive_us=45_000))
    session = join(slave)
    said = [(step, d) for step in range(1, 1001) for d in send_position(slave, session, step, step * 1000, ack=1)]
    assert [d.kind for _, d in said[:2]] == [Kind.FORCE, Kind.KEEPALIVE]
    assert {d.kind for _, d in said[1:]} == {Kind.KEEPALIVE}
    assert [step for step, _ in said] == list(range(1, 1001, 45))
    slave.tick(3_000_000)
    assert slave.datagrams_to_send() == []


def test_an_unacknowledged_force_is_replaced_by_the_present_one_at_growing_intervals():
    slave = make_slave()
    session = join(slave)
    forces = []
    for step in range(1, 2001):
        for datagram in send_position(slave, session, step, step * 1000, position_m=0.025):
            if datagram.kind is Kind.FORCE:
                forces.append(step)
                newest = datagram.sequence
    assert forces == [1, 102, 303, 704, 1505]
    send_position(slave, session, 2001, 2_001_000, position_m=0.025, ack=newest)
    kinds = {d.kind for s in range(2002, 6000) for d in send_position(slave, session, s, s * 1000, position_m=0.025)}
    assert kinds == {Kind.KEEPALIVE}


def test_a_late_copy_of_the_hello_rewinds_nothing():
    slave = make_slave()
    session = join(slave)
    first = [d.sequence for step in range(1, 400) for d in send_position(slave, session, step, step * 1000)]
    slave.receive_datagram(pack_hello(HELLO, 0), "a", 400_000)
    assert answer(slave).kind is Kind.WELCOME
    then = [d.sequence for step in range(400, 800) for d in send_position(slave, session, step, step * 1000)]
    assert first + then == list(range(1, 1 + len(first + then)))


def test_a_hello_of_the_past_or_one_that_is_refused_leaves_the_session_that_stands():
    slave = make_slave(session=SessionSettings(most_sessions=2))
    join(slave, nonce=1)
    session = join(slave, nonce=2)
    join(slave, "half open", nonce=3)
    send_position(slave, session, 1, 0)
    slave.receive_datagram(pack_hello(HELLO._replace(nonce=1), 0), "a", 10)
    assert slave.datagrams_to_send() == []
    slave.receive_datagram(pack_hello(HELLO._replace(nonce=4, codec="mp3"), 0), "a", 20)
    assert answer(slave).kind is Kind.REFUSE
    slave.receive_datagram(pack_hello(HELLO._replace(nonce=5, codec="mp3"), 0), "stranger", 20)
    assert answer(slave).kind is Kind.REFUSE
    assert [station.address for station in slave.stations] == ["a", "half open"]
    assert slave.stations[0].session.number == session


def test_a_master_that_died_gives_its_place_to_the_one_that_comes_back():
    slave = make_slave(session=SessionSettings(most_sessions=1, gives_way_us=1_000_000))
    send_position(slave, join(slave, "before"), 1, 0, address="before")
    slave.receive_datagram(pack_hello(HELLO._replace(nonce=2), 0), "after", 900_000)
    assert answer(slave).kind is Kind.REFUSE
    join(slave, "after", now_us=1_100_000, nonce=2)
    assert [station.address for station in slave.stations] == ["after"]


def test_silent_sessions_are_forgotten_half_open_ones_sooner():
    slave = make_slave(session=SessionSettings(idle_after_us=5_000_000, half_open_us=1_000_000))
    join(slave, "quiet")
    talkative = join(slave, "talkative", nonce=2)
    send_position(slave, talkative, 1, 0, address="talkative")
    slave.tick(1_000_000)
    assert [station.address for station in slave.stations] == ["talkative"]
    assert slave.next_timer_us() == 5_000_000
    slave.tick(5_000_000)
    assert slave.stations == ()
    assert slave.next_timer_us() is None
    ends = [event.station.session.end_reason for event in iter(slave.next_event, None) if isinstance(event, MasterLeft)]
    assert ends == ["nothing arrived from the master"]
    assert slave.report()["never_used"] == 1


def test_a_flood_of_hellos_takes_no_place_from_a_master_at_work_and_memory_stays_flat():
    slave = make_slave(session=SessionSettings(most_sessions=8))
    worker = join(slave, "worker")
    send_position(slave, worker, 1, 0, address="worker")
    for nonce in range(20_000):
        slave.receive_datagram(pack_hello(HELLO._replace(nonce=nonce), 0), nonce, 10)
        slave.datagrams_to_send()
        while slave.next_event():
            pass
    assert len(slave.stations) == 8
    assert len(slave.report()["sessions"]) == 1, "sessions without a position do not displace others from the account"
    assert slave.stations[0].address == "worker"
    assert slave.stations[0].session.state is SlaveState.OPEN


def test_when_every_place_is_in_use_a_newcomer_is_refused():
    slave = make_slave(session=SessionSettings(most_sessions=2))
    for number in range(2):
        send_position(slave, join(slave, number, nonce=number), 1, 0, address=number)
    slave.receive_datagram(pack_hello(HELLO, 0), "late", 10)
    assert unpack_refuse(answer(slave).body)[1:] == ("all 2 sessions of this slave are taken", Code.FULL)


def test_garbage_by_the_ten_thousand_is_counted_and_answers_nothing():
    slave = make_slave()
    session = join(slave)
    good = pack(Kind.POSITION, session, 1, pack_body(Position(0, None, bytes(4))))
    rng = np.random.default_rng(2)
    for number in range(30_000):
        data = (rng.bytes(int(rng.integers(0, 80))), good[: number % len(good)], bytes(1201 + number % 60))[number % 3]
        slave.receive_datagram(data, "a", 0)
    assert slave.datagrams_to_send() == []
    assert slave.strangers.malformed == 30_000
    assert send_position(slave, session, 1, 0) != []


def test_a_close_is_answered_and_its_account_kept():
    slave = make_slave()
    session = join(slave)
    send_position(slave, session, 1, 0)
    slave.receive_datagram(pack(Kind.CLOSE, session, 2, pack_body(Close("done"))), "a", 0)
    assert answer(slave).kind is Kind.CLOSE
    assert slave.stations == ()
    assert slave.report()["sessions"][0]["end_reason"] == "the master closed: done"


def test_sessions_that_were_never_used_are_accounted_for_to_the_byte():
    slave = make_slave(session=SessionSettings(idle_after_us=5_000_000, half_open_us=1_000_000))
    received = sent = 0
    for number in range(3):
        hello = pack_hello(HELLO._replace(nonce=number), 0)
        slave.receive_datagram(hello, str(number), 0)
        slave.receive_datagram(pack(Kind.CLOSE, 99, 0, b""), "stranger", 0)
        received += len(hello) + len(pack(Kind.CLOSE, 99, 0, b""))
        sent += sum(len(data) for data, _ in slave.datagrams_to_send())
    slave.tick(2_000_000)
    report = slave.report()
    assert report["never_used"] == 3
    assert report["strangers"]["payload_bytes"] == received
    assert report["to_strangers"]["payload_bytes"] == sent
    assert report["to_strangers"]["by_kind"] == {"welcome": 3, "reset": 3}
