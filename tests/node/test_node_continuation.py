"""A session that goes on with the scene of another: by ticket or by name, on the same clock or on another one."""

import gc
from weakref import WeakSet

import numpy as np
import pytest

from hapticnet.node.events import MasterJoined, MasterLeft
from hapticnet.protocol.messages import TICKET_BYTES, Close
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.wire import Kind
from hapticnet.samples import ForceSample
from hapticnet.scene.sources import find_source
from tests.conftest import make_slave
from tests.peers import OTHER_KEY, HandMaster, events_of

SECOND = 1_000_000


class Clock:
    """A scene that remembers the times it was stepped to."""

    name = "clock"
    axes = 1
    breaches = 0

    def __init__(self):
        self.t_us = []

    def step(self, sample):
        self.t_us.append(sample.t_us)
        return ForceSample(sample.t_us, (0.0,))


@pytest.fixture
def slave(sealed):
    return make_slave(sealed=sealed, host_of=lambda address: address[0])


def master(slave, sealed, port, **request):
    return HandMaster(slave, ("host", port), sealed=sealed, nonce=port, **request)


def with_clock(slave):
    slave._admission._make_scene = lambda _: Clock()


def play(one, start_us, steps, *, first=1, offset_us=0, position_m=0.0):
    """Send positions every millisecond from `start_us`, by a clock that is `offset_us` ahead of the slave's."""
    for step in range(steps):
        now_us = start_us + 1000 * step
        one.position(first + step, now_us, position_m, t_us=now_us + offset_us)


def test_a_ticket_continues_the_scene_and_the_old_session_ends_when_the_new_one_is_proved(slave, sealed):
    old = master(slave, sealed, 1).work()
    scene = slave.contexts[0].scene
    new = master(slave, sealed, 2, ticket=old.grant.ticket).join(1000)
    assert new.grant.resumed
    assert not old.grant.resumed
    assert new.grant.ticket != old.grant.ticket
    assert len(new.grant.ticket) == TICKET_BYTES
    assert old.position(2, 2000) == []
    assert slave.contexts[0].steps == 2, "until then the old one is served as before"
    events_of(slave)
    new.position(1, 3000)
    (context,) = slave.contexts
    assert context.scene is scene
    assert context.report()["continues"] == old.session
    left, joined = events_of(slave)
    assert (left, joined) == (MasterLeft(left.context), MasterJoined(context))
    assert left.context.session.end_reason == "its master goes on in a new session"
    assert [answer.kind for answer in old.position(3, 4000)] == [Kind.RESET]


@pytest.mark.parametrize("ticket", [bytes(16), b"guessed a ticket"])
def test_a_wrong_ticket_gets_a_new_scene_and_ends_nothing(slave, sealed, ticket):
    old = master(slave, sealed, 1).work()
    new = master(slave, sealed, 2, ticket=ticket).work(SECOND)
    assert not new.grant.resumed
    assert len({id(context.scene) for context in slave.contexts}) == 2
    assert old.position(2, SECOND) != []


def test_the_ticket_of_another_identity_is_worth_nothing(slave, sealed):
    old = master(slave, sealed, 1).work()
    for nonce, request in ((2, {"ticket": old.grant.ticket}), (3, {})):  # without a ticket: the name of a silent master
        thief = HandMaster(slave, ("thief", nonce), sealed=sealed, nonce=nonce, key=OTHER_KEY, **request).work(SECOND)
        assert not thief.grant.resumed
    assert old.position(2, SECOND) != []


def test_a_ticket_is_spent_with_its_session(slave, sealed):
    first = master(slave, sealed, 1).work()
    second = master(slave, sealed, 2, ticket=first.grant.ticket).work()
    third = master(slave, sealed, 3, ticket=first.grant.ticket, name="third").work()
    assert not third.grant.resumed
    assert [context.session.number for context in slave.contexts] == [second.session, third.session]


def test_a_master_that_was_welcomed_and_lost_its_link_at_once_continues_all_the_same(slave, sealed):
    """Its ticket is that of a session of which no position arrived, and which the slave has forgotten."""
    with_clock(slave)
    first = master(slave, sealed, 1).join(0)
    play(first, 1000, 20, offset_us=777)
    scene = slave.contexts[0].scene
    last = first
    for port in range(2, 40):  # again and again
        now_us = 6 * SECOND * port
        last = master(slave, sealed, port, ticket=last.grant.ticket).join(now_us)
        assert last.grant.resumed, port
        play(first, now_us, 20, first=100 * port, offset_us=777)  # so that the scene is kept
        slave.tick(now_us + 5_500_000)
        assert len(slave.contexts) == 1
    last = master(slave, sealed, 99, ticket=last.grant.ticket).join(now_us + 1000)
    play(last, now_us + 2000, 20, offset_us=777)
    (context,) = slave.contexts
    assert context.scene is scene
    assert scene.t_us[-1] - scene.t_us[0] == now_us + 2000 + 19_000 - 1000


def test_the_ticket_of_a_restarted_master_takes_no_scene_from_the_one_that_works_again(slave, sealed):
    first = master(slave, sealed, 1).work(0)
    second = master(slave, sealed, 2).join(SECOND)
    assert second.grant.resumed
    play(first, SECOND, 20, first=2)
    third = master(slave, sealed, 3, ticket=second.grant.ticket).work(SECOND + 20_000)
    assert not third.grant.resumed
    assert len(slave.contexts) == 3
    assert [answer.kind for answer in second.position(1, SECOND + 25_000)] == [Kind.CLOSE]
    steps = slave.contexts[0].steps
    first.position(100, SECOND + 30_000)
    assert slave.contexts[0].steps == steps + 1


def test_tickets_that_were_given_out_beside_each_other_are_known_to_the_session_that_continues(slave, sealed):
    first = master(slave, sealed, 1).work(0)
    second = master(slave, sealed, 2, ticket=first.grant.ticket).join(1000)
    third = master(slave, sealed, 3, ticket=first.grant.ticket).join(2000)
    second.position(1, 3000)
    assert len(slave.contexts) == 2
    assert [answer.kind for answer in third.position(1, 4000)] == [Kind.CLOSE]
    fourth = master(slave, sealed, 4, ticket=third.grant.ticket).work(5000)
    assert fourth.grant.resumed
    assert [context.session.number for context in slave.contexts] == [fourth.session]


def test_after_a_close_there_is_nothing_to_continue(slave, sealed):
    first = master(slave, sealed, 1).work()
    first.say(Kind.CLOSE, 2, Close("done"), 0)
    assert not master(slave, sealed, 2, ticket=first.grant.ticket).work(SECOND).grant.resumed


@pytest.mark.parametrize(("silence_us", "resumed"), [(200_000, False), (200_001, True)])
def test_a_restarted_master_is_known_by_its_name_after_200_ms_of_silence(slave, sealed, silence_us, resumed):
    master(slave, sealed, 1).work(0)
    assert master(slave, sealed, 2).join(silence_us).grant.resumed is resumed
    assert master(slave, sealed, 3, name="another").join(silence_us).grant.resumed is False
    scenes = {id(context.scene) for context in slave.contexts}
    assert len(scenes) == (2 if resumed else 3)


@pytest.mark.parametrize("offset_us", [0, 10**9, (1 << 32) - 5_000, 7 * (1 << 31)])
def test_with_a_ticket_the_time_of_the_scene_goes_on_with_the_clock_of_its_master(slave, sealed, offset_us):
    with_clock(slave)
    first = master(slave, sealed, 1).join(0)
    play(first, 1000, 20, offset_us=offset_us)
    second = master(slave, sealed, 2, ticket=first.grant.ticket).join(100_000)
    play(second, 100_000, 20, offset_us=offset_us)
    third = master(slave, sealed, 3, ticket=second.grant.ticket).join(200_000)
    play(third, 200_000, 20, offset_us=offset_us)
    (context,) = slave.contexts
    times = np.array(context.scene.t_us)
    expected = [start + 1000 * step for start in (1000, 100_000, 200_000) for step in range(20)]
    assert (times - times[0]).tolist() == [each - 1000 for each in expected]


@pytest.mark.parametrize("again", [False, True], ids=["goes on", "asks again"])
def test_the_time_of_the_scene_goes_on_after_a_silence_in_which_time_stamps_wrapped(slave, sealed, again):
    with_clock(slave)
    old = master(slave, sealed, 1).work(SECOND)
    late_us = 3001 * SECOND
    if again:
        old = master(slave, sealed, 2, ticket=old.grant.ticket, clock_us=late_us).join(late_us)
    old.position(2, late_us)
    assert slave.contexts[0].scene.t_us == [SECOND, late_us]


@pytest.mark.parametrize("offset_us", [-(10**7), 0, 10**9, 3 * (1 << 31), (1 << 32) - 3_000_000])
def test_over_a_restart_with_another_clock_the_time_of_the_scene_goes_on_evenly(slave, sealed, offset_us):
    with_clock(slave)
    start_us = 20 * SECOND
    play(master(slave, sealed, 1).join(start_us), start_us, 1000, offset_us=12_345)
    second = master(slave, sealed, 2).join(start_us + 3 * SECOND)
    play(second, start_us + 3 * SECOND, 1000, offset_us=offset_us)
    third = master(slave, sealed, 3, ticket=second.grant.ticket).join(start_us + 4 * SECOND)
    play(third, start_us + 4 * SECOND, 1000, offset_us=offset_us)
    (context,) = slave.contexts
    times = np.array(context.scene.t_us)
    steps = np.diff(times)
    assert (np.delete(steps, 999) == 1000).all()
    assert steps[999] == 3 * SECOND - 999_000, "the time that went by at the slave"


def test_a_half_open_session_never_ends_the_one_that_works(slave, sealed):
    """One forged HELLO used to be enough: the address, the name and even the ticket of the victim are known."""
    victim = master(slave, sealed, 1).work()
    scene = slave.contexts[0].scene
    for port, request in ((2, {}), (3, {"ticket": victim.grant.ticket})):
        forged = HandMaster(slave, victim.address, sealed=sealed, nonce=port, **request)
        forged.join(0)
    play(victim, 1000, 100, first=2)
    slave.tick(6 * SECOND)
    (context,) = slave.contexts
    assert (context.session.number, context.session.state) == (victim.session, SlaveState.OPEN)
    assert context.scene is scene
    assert context.steps == 101


def test_pierced_tissue_stays_pierced(slave, sealed):
    """The tool is in the tissue when its master dies, and when it loses its session: nothing is felt twice."""
    one, began = master(slave, sealed, 1).join(0), 1
    whole = HandMaster(make_slave(sealed=sealed), sealed=sealed).join(0)
    for step, depth_m in enumerate(np.linspace(0.0, 0.06, 4000), start=1):
        now_us = 1000 * step
        if step in (2500, 3000):
            ticket, began = (one.grant.ticket if step == 3000 else None), step
            one = master(slave, sealed, step, ticket=ticket).join(now_us + 3 * SECOND)
        one.position(1 + step - began, now_us + (3 * SECOND if step >= 2500 else 0), depth_m, t_us=now_us)
        whole.position(step, now_us, depth_m)
        if step in (2499, 2500, 2999, 3000, 4000):
            (interrupted,), (other,) = slave.contexts, whole.slave.contexts
            assert interrupted.scene.breaches == other.scene.breaches
            assert interrupted.scene.force_n == pytest.approx(other.scene.force_n)
    assert interrupted.grant.resumed
    assert other.scene.breaches > 1


def test_a_continuing_session_needs_no_second_place(sealed):
    slave = make_slave(sealed=sealed, session=SessionSettings(most_sessions=1, most_per_identity=1))
    first = HandMaster(slave, sealed=sealed).work()
    second = HandMaster(slave, sealed=sealed, nonce=2, ticket=first.grant.ticket).work()
    assert second.grant.resumed
    assert [context.session.number for context in slave.contexts] == [second.session]


@pytest.mark.plain
def test_a_chain_of_sessions_does_not_stay_in_memory(slave, sealed):
    contexts = WeakSet()
    last = master(slave, sealed, 1).work()
    for port in range(2, 20):
        contexts.update(slave.contexts)
        last = master(slave, sealed, port, ticket=last.grant.ticket).work(SECOND * port)
    (context,) = slave.contexts
    assert context.continues is None
    assert len(slave._contexts) == 1
    assert not slave._welcomes, "its master has the WELCOME"
    events_of(slave)
    slave.tick(24 * SECOND)  # the newest that ended would have expired by now
    gc.collect()
    assert slave.contexts == (context,)
    assert not [each for each in contexts if each is not context]


@pytest.mark.plain
def test_masters_touch_a_shared_object_at_the_same_time(slave, sealed, tmp_path):
    rig = tmp_path / "rig.py"
    rig.write_text("class Wall:\n    shared = True\n\n    def step(self, sample):\n        return 0.0\n")
    source = find_source(f"{rig}:Wall")
    slave._admission._make_scene = lambda _: source.make()
    pair = [master(slave, sealed, port, name=f"master {port}").join(0) for port in (1, 2)]
    for step in range(1, 3000):
        for each in pair:
            each.position(step, 1000 * step)
    one, other = slave.contexts
    assert one.steps == other.steps == 2999
    assert one.scene.touched is other.scene.touched
    assert source.close() == []
