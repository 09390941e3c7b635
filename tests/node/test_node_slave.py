"""The slave at work: positions, forces, steps between positions, ends; open and sealed."""

from collections import deque

import numpy as np
import pytest

from hapticnet.codec.positions import PromisedLine, pack_line
from hapticnet.node.admission import ALL_HZ, EACH_HZ, MOST_AT_ONCE, SMALLEST_SESSION
from hapticnet.node.events import MasterJoined, MasterLeft
from hapticnet.protocol import slave_session
from hapticnet.protocol.keys import MasterEntry
from hapticnet.protocol.messages import TICKET_BYTES, Close, Position
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.slave_session import POLICED_BURST_S, POLICED_SHARE
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.stats import BEHIND_IN_A_ROW, MISORDER
from hapticnet.protocol.wire import Kind
from tests.conftest import make_slave
from tests.peers import MASTER, HandMaster, events_of

DEEP_M = 0.025
SECOND = 1_000_000


def joined(sealed, **settings):
    """Return a slave and a master made by hand that has a session, without a position yet."""
    slave = make_slave(sealed=sealed, session=SessionSettings(**settings))
    return slave, HandMaster(slave, sealed=sealed).join()


def account(slave):
    return slave.contexts[0].session.received


def test_the_first_position_makes_a_session_of_a_promise(sealed):
    slave, master = joined(sealed)
    (context,) = slave.contexts
    assert context.session.state is SlaveState.HALF_OPEN
    assert events_of(slave) == []
    assert [d.kind for d in master.position(1, 1000)] == [Kind.FORCE]
    assert context.session.state is SlaveState.OPEN
    assert events_of(slave) == [MasterJoined(context)]


def test_a_position_of_an_unknown_session_is_answered_with_reset(sealed):
    slave, master = joined(sealed)
    master.position(1, 0)
    data = master.pack(Kind.POSITION, 2, (1000, None, bytes(4)))
    slave.close("gone", 0)
    slave.datagrams_to_send()
    (reset,) = master.send(data, 1000)
    assert (reset.kind, reset.version, reset.session, reset.sequence) == (Kind.RESET, master.version, master.session, 2)


def test_a_position_older_than_the_newest_does_not_move_the_scene(sealed):
    slave, master = joined(sealed)
    master.position(5, 1000, DEEP_M)
    force = slave.contexts[0].scene.force_n
    assert force > 0
    assert master.position(4, 2000) == []
    assert master.position(5, 2000) == []
    assert slave.contexts[0].scene.force_n == force
    assert (account(slave).late, account(slave).duplicate) == (1, 1)


@pytest.mark.parametrize("ahead", [2, 50, 200, 2999, 3000, 32_767, 1 << 30, (1 << 31) - 1])
def test_one_forged_number_does_not_deafen_an_open_session_for_long(ahead):
    slave, master = joined(sealed=False)
    master.position(1, 1000)
    master.position(1 + ahead, 1500)
    before = slave.contexts[0].steps
    for step in range(2, 402):
        master.position(step, 1000 * step, DEEP_M)
    near = ahead <= MISORDER + BEHIND_IN_A_ROW
    assert 400 - (slave.contexts[0].steps - before) <= (ahead if near else BEHIND_IN_A_ROW)
    assert slave.contexts[0].scene.force_n > 0.0


@pytest.mark.parametrize("payload", [b"", b"123", bytes.fromhex("7fc00000"), bytes.fromhex("7f800000"), bytes(12)])
def test_a_position_that_is_not_finite_or_not_of_the_right_size_is_malformed_and_moves_nothing(sealed, payload):
    slave, master = joined(sealed)
    master.position(1, 1000, DEEP_M)
    assert master.position(2, 2000, payload=payload) == []
    assert account(slave).malformed == 1
    assert account(slave).packets == 3, "HELLO and two POSITIONs, each counted once"
    assert slave.contexts[0].steps == 1
    assert [d.kind for d in master.position(3, 3000, 0.028)] == [Kind.FORCE]


def test_only_the_newest_position_of_each_session_is_answered(sealed):
    """A slave that was stopped for a while finds everything at once that its masters sent meanwhile."""
    slave = make_slave(sealed=sealed)
    masters = [HandMaster(slave, address, sealed=sealed, nonce=nonce).work() for nonce, address in enumerate("abc", 1)]
    batch = []
    for step in range(2, 500):
        for depth_m, master in enumerate(masters):
            payload = np.array(DEEP_M + 0.001 * depth_m, ">f4").tobytes()
            batch.append((master.pack(Kind.POSITION, step, (1000 * step, 1, payload)), master.address))
    slave.receive_datagrams(batch, 10 * SECOND)
    for master, context, (data, address) in zip(masters, slave.contexts, slave.datagrams_to_send(), strict=True):
        answer = master._read(data)
        assert (answer.kind, address) == (Kind.FORCE, master.address)
        assert context.steps == 2
        assert context.superseded == 497
        assert context.report()["superseded"] == 497
    slave.account_sent(10 * SECOND)
    assert len({id(context.scene) for context in slave.contexts}) == 3
    for context in slave.contexts:
        assert context.recording.table()["t_us"].tolist() == [0, 499_000]


def test_positions_that_overtake_each_other_within_a_batch_leave_the_newest(sealed):
    slave, master = joined(sealed)
    batch = [(master.pack(Kind.POSITION, step, (1000 * step, None, bytes(4))), "a") for step in (3, 5, 4, 1, 2)]
    slave.receive_datagrams(batch, 10_000)
    slave.account_sent(10_000)
    assert slave.contexts[0].recording.table()["t_us"].tolist() == [5000]


def test_a_master_faster_than_granted_is_served_at_the_granted_rate(sealed):
    slave = make_slave(sealed=sealed)
    master = HandMaster(slave, sealed=sealed, rate_hz=1000.0).join()
    for step in range(1, 40_001):
        master.position(step, 100 * step, t_us=step)
    (context,) = slave.contexts
    most = POLICED_SHARE * 1000 * 4 + POLICED_BURST_S * 1000
    assert most - 2 <= context.steps <= most + 1
    assert context.session.received.over_rate == 40_000 - context.steps
    assert context.report()["received"]["over_rate"] == 40_000 - context.steps


@pytest.mark.parametrize("period_us", [1000, 990, 910])
def test_a_clock_that_runs_a_little_fast_and_a_network_that_bursts_lose_nothing(period_us):
    slave, master = joined(sealed=False)
    for step in range(1, 10_001):
        held_back = step * period_us // 500_000 * 500_000 + 500_000  # half a second at once
        master.position(step, held_back, t_us=step * period_us)
    assert account(slave).over_rate == 0


def test_keepalives_fill_silence_only_while_positions_arrive(sealed):
    slave, master = joined(sealed, keepalive_us=45_000)
    said = [(step, d) for step in range(1, 1001) for d in master.position(step, step * 1000, ack=1)]
    assert [d.kind for _, d in said[:2]] == [Kind.FORCE, Kind.KEEPALIVE]
    assert {d.kind for _, d in said[1:]} == {Kind.KEEPALIVE}
    assert [step for step, _ in said] == list(range(1, 1001, 45))
    slave.tick(3 * SECOND)
    assert slave.datagrams_to_send() == []


def test_an_unacknowledged_force_is_replaced_by_the_present_one_at_growing_intervals(sealed):
    _, master = joined(sealed)
    forces = []
    for step in range(1, 2001):
        for datagram in master.position(step, step * 1000, DEEP_M):
            if datagram.kind is Kind.FORCE:
                forces.append(step)
                newest = datagram.sequence
    assert forces == [1, 102, 303, 704, 1505]
    master.position(2001, 2_001_000, DEEP_M, ack=newest)
    kinds = {d.kind for step in range(2002, 6000) for d in master.position(step, step * 1000, DEEP_M)}
    assert kinds == {Kind.KEEPALIVE}


def test_a_close_is_answered_and_its_account_kept(sealed):
    slave, master = joined(sealed)
    master.position(1, 0)
    assert [d.kind for d in master.say(Kind.CLOSE, 2, Close("done"), 0)] == [Kind.CLOSE]
    assert slave.contexts == ()
    assert slave.report()["sessions"][0]["end_reason"] == "the master closed: done"
    assert isinstance(events_of(slave)[-1], MasterLeft)


def test_a_close_of_the_past_ends_nothing(sealed):
    slave, master = joined(sealed)
    master.position(9, 0)
    assert master.say(Kind.CLOSE, 8, Close("done"), 0) == []
    assert len(slave.contexts) == 1


def test_silent_sessions_are_forgotten_half_open_ones_sooner(sealed):
    slave = make_slave(sealed=sealed, session=SessionSettings(keep_us=30 * SECOND, half_open_us=5 * SECOND))
    HandMaster(slave, "quiet", sealed=sealed).join()
    HandMaster(slave, "talkative", sealed=sealed, nonce=2).work()
    slave.tick(5 * SECOND)
    assert [context.address for context in slave.contexts] == ["talkative"]
    assert slave.next_timer_us() == 30 * SECOND
    slave.tick(30 * SECOND)
    assert slave.contexts == ()
    assert slave.next_timer_us() is None
    ends = [event.context.session.end_reason for event in events_of(slave) if isinstance(event, MasterLeft)]
    assert ends == ["nothing arrived from the master"]
    assert slave.report()["never_used"] == 1


def test_what_the_slave_knew_of_ended_sessions_is_gone(sealed):
    slave = make_slave(sealed=sealed)
    for number in range(1, 200):
        master = HandMaster(slave, sealed=sealed, nonce=number).work(SECOND * number)
        master.say(Kind.CLOSE, 2, Close("done"), SECOND * number)
    assert (slave._contexts, slave._welcomes, slave._to_answer) == ({}, {}, [])


def test_a_position_that_is_refused_takes_no_seat_and_ends_no_session(sealed):
    slave = make_slave(sealed=sealed)
    old = HandMaster(slave, sealed=sealed).work()
    new = HandMaster(slave, sealed=sealed, nonce=2, ticket=old.grant.ticket).join()
    assert new.grant.resumed
    assert not new.position(1, 1000, payload=b"no position")
    assert [type(event) for event in events_of(slave)] == [MasterJoined]
    assert old.position(2, 60_000)[0].kind is Kind.KEEPALIVE
    new.position(1, 61_000)
    assert [type(event) for event in events_of(slave)] == [MasterLeft, MasterJoined]


def test_a_master_that_joined_is_said_to_leave_even_if_no_position_was_answered(sealed):
    slave = make_slave(sealed=sealed)
    master = HandMaster(slave, sealed=sealed).join()
    both = [master.pack(Kind.POSITION, 1, Position(0, None, bytes(4))[:3]), master.pack(Kind.CLOSE, 2, Close("done"))]
    slave.receive_datagrams([(data, "a") for data in both], 0)
    slave.account_sent(0)
    assert [type(event) for event in events_of(slave)] == [MasterJoined, MasterLeft]
    assert slave.report()["never_used"] == 0
    (session,) = slave.report()["sessions"]
    assert session["end_reason"] == "the master closed: done"


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


PRESSING_M = 0.025


class Hall:
    """A slave, and masters that send a line each 100 ms, those of a host one after another."""

    def __init__(self, **session):
        self.slave = make_slave(session=SessionSettings(**session), record=False, host_of=lambda address: address[0])
        self.masters = []
        self.now_us = SECOND
        self.positions = 0
        self.most_at_once = 0

    def join(self, host, count=1, **request):
        """Let masters of a host join; return them."""
        joined = []
        for _ in range(count):
            self.now_us += SECOND // 4  # as often as requests of a host are read
            number = len(self.masters)
            master = HandMaster(
                self.slave, (host, number), nonce=1 + number, position_share=0.25, name=f"{host} {number}",
                **({"rate_hz": 10_000.0} | request),
            ).join(self.now_us)  # fmt: skip
            assert master.grant.position_share == 0.25
            self.masters.append(master)
            joined.append(master)
        return joined

    def play(self, seconds, masters=None):
        """Let masters send their lines, all at once each time; return the steps between positions of each session."""
        masters = self.masters if masters is None else masters
        before = self.between()
        for _ in range(round(10 * seconds)):
            for master in masters:
                self.positions += 1
                line = pack_line(PromisedLine(0, (PRESSING_M,), (0.001,), (0.0,)))
                master.say(Kind.POSITION, self.positions, (self.now_us, 1, line), self.now_us)
            end_us = self.now_us + SECOND // 10
            while (next_us := self.slave.next_timer_us()) is not None and next_us < end_us:
                self.now_us = max(self.now_us + 1, next_us)
                steps = self.slave.totals()[0]
                self.slave.tick(self.now_us)
                self.most_at_once = max(self.most_at_once, self.slave.totals()[0] - steps)
                self.slave.account_sent(self.now_us)
                self.slave.datagrams_to_send()
            self.now_us = end_us
        after = self.between()
        return [after[each] - before.get(each, 0) for each in after]

    def between(self):
        return {each["session"]: each["between"] for each in self.slave.report()["sessions"]}


@pytest.mark.parametrize("rate_hz", [1000.0, 4000.0])
def test_a_usual_session_is_stepped_at_each_of_its_times(rate_hz):
    hall = Hall()
    hall.join("good", rate_hz=rate_hz)
    hall.play(0.3)
    (steps,) = hall.play(2.0)
    assert steps == pytest.approx(2.0 * rate_hz, rel=0.02)


@pytest.mark.parametrize("codec", ["deadband", "linear-predictive"])
def test_ten_datagrams_a_second_do_not_buy_ten_thousand_steps(codec):
    hall = Hall()
    hall.join("bad", codec=codec)
    hall.play(0.3)
    (steps,) = hall.play(2.0)
    assert 0.0 < steps <= 2.0 * EACH_HZ


def test_an_identity_gets_so_many_steps_with_as_many_sessions_as_it_may_have():
    hall = Hall()
    hall.join("bad", 16)
    hall.play(0.3)
    steps = hall.play(1.0)
    assert 0.5 * EACH_HZ < sum(steps) <= EACH_HZ
    assert min(steps) > 0.9 * max(steps), "all are served alike"


def test_all_together_get_so_many_and_who_asks_for_little_is_served_beside_them():
    hall = Hall()
    hall.join("good", rate_hz=1000.0)
    for host in ("bad", "worse"):
        hall.join(host, 16)
    hall.play(0.3)
    good, *others = hall.play(1.0)
    assert good == pytest.approx(1000, abs=20)
    assert sum(others) <= 2 * EACH_HZ
    hall.join("worst", 16)
    hall.play(0.3)
    good, *others = hall.play(1.0)
    assert good + sum(others) <= ALL_HZ
    assert good > 400
    assert hall.most_at_once <= MOST_AT_ONCE


def test_what_sessions_do_not_use_any_more_is_there_for_others():
    hall = Hall()
    first, *others = hall.join("lab", 8, rate_hz=1000.0)
    hall.play(0.3)
    assert hall.play(1.0)[0] == pytest.approx(500, abs=20)
    hall.play(0.3, [first])  # the others are silent
    assert hall.play(1.0, [first])[0] == pytest.approx(1000, abs=20)
    assert len(others) == 7
    hall.play(0.3)
    assert hall.play(1.0)[0] == pytest.approx(500, abs=20), "they are back"
    for master in others:
        master.say(Kind.CLOSE, hall.positions + 1, Close("done"), hall.now_us)
    assert hall.slave.session_count == 1
    hall.play(0.3, [first])
    assert hall.play(1.0, [first])[-1] == pytest.approx(1000, abs=20)
