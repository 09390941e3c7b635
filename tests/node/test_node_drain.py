"""A slave that is to stop takes no new masters, lets the present ones finish, and no force is cut off."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.settings import ChannelSettings
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import NOTICES_AT_ONCE, SlaveNode
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.keys import Roster
from hapticnet.protocol.messages import Code
from hapticnet.protocol.states import Connected, Ended, MasterState, Noticed, Refused, SessionLost, SlaveState
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene
from tests.peers import ENTRY, KEY, SLAVE

MS = 1000
SECOND = 1000 * MS
each_slave = pytest.mark.parametrize("sealed", [False, True])


class Hand:
    axes, duration_us = 1, None

    def sample(self, t_us):
        return PositionSample(t_us, (0.024 + 0.002 * np.sin(2e-6 * np.pi * t_us),))


def make_slave():
    rng = np.random.default_rng(1)
    doors = {1: Door(), 2: SealedDoor(SLAVE.private, Roster([ENTRY]), rng)}
    return SlaveNode(lambda _: Scene(paper_scene(1).tissues), SlaveSettings(), rng, doors=doors)


def make_master(sealed, seed=2):
    settings = MasterSettings(key=KEY if sealed else None)
    return MasterNode(Hand(), None, settings, np.random.default_rng(seed))


def linked(sealed):
    channels = [Emulator(ChannelSettings(), np.random.default_rng(each)) for each in (3, 4)]
    return Loopback(make_master(sealed), make_slave(), forward=channels[0], feedback=channels[1])


def events(node):
    return list(iter(node.next_event, None))


@each_slave
def test_a_running_master_is_told_and_keeps_its_force_until_it_has_finished(sealed):
    link = linked(sealed)
    link.run(SECOND)
    held_n = link.master.held_n[0]
    assert held_n > 0.1
    link.slave.drain(link.now_us)
    assert not link.slave.drained
    for _ in range(10):
        link.run(SECOND // 2)
        link.slave.check(link.now_us)
        link.slave.account_sent(link.now_us)
        assert link.master.held_n[0] > 0.1
    told = [each for each in events(link.master) if isinstance(each, Noticed)]
    assert [each.code for each in told] == [Code.STOPPING], "once, although the slave repeats it"
    assert link.master.session.received.by_kind[10] >= 2
    assert link.master.report()["notices"]
    link.close()
    assert link.slave.drained
    assert link.slave.report()["sessions"][0]["superseded"] == 0


@each_slave
def test_the_end_of_the_time_cuts_no_force(sealed):
    link = linked(sealed)
    link.run(SECOND)
    link.slave.drain(link.now_us)
    link.run(SECOND)
    before_n = link.master.held_n[0]
    link.slave.close("shutting down", link.now_us)
    held_n = [before_n]
    for _ in range(400):
        link.run(MS)
        held_n.append(link.master.held_n[0])
    assert held_n[-1] == 0.0
    assert max(-np.diff(held_n)) <= 1.05 * max(held_n) / 100, "it falls over a tenth of a second"
    (lost,) = [each for each in events(link.master) if isinstance(each, SessionLost)]
    assert "shutting down" in lost.reason


@each_slave
def test_a_new_master_is_refused_with_a_reason_and_asks_again(sealed):
    link = linked(sealed)
    link.run(100 * MS)
    link.slave.drain(link.now_us)
    link.slave.close("shutting down", link.now_us)
    late = Loopback(make_master(sealed, 5), link.slave, forward=link.forward, feedback=link.feedback)
    late.now_us = late._next_tick_us = link.now_us
    late.run(4 * SECOND)
    found = events(late.master)
    assert not [each for each in found if isinstance(each, Ended | Connected)]
    refused = [each for each in found if isinstance(each, Refused)]
    assert {each.code for each in refused} == {Code.STOPPING}
    assert [each.retry_us for each in refused][:2] == [SECOND, 2 * SECOND]
    assert late.master.session.state is MasterState.CONNECTING
    late.slave = make_slave()  # the next one at this address
    late.run(6 * SECOND)
    assert late.master.connected


@each_slave
def test_a_running_master_may_change_its_codec_while_the_slave_waits(sealed):
    link = linked(sealed)
    link.run(SECOND)
    link.slave.drain(link.now_us)
    link.master.change(codec="raw")
    link.run(SECOND)
    assert link.master.connections == 2
    assert link.master.codec.name == "raw"


@pytest.mark.plain
def test_a_thousand_masters_are_told_a_few_at_a_time():
    """Telling all of them at once would hold up the forces of each."""
    slave = make_slave()

    class Told:
        seated = True

        def __init__(self):
            self.session, self.count = self, 0

    contexts = [Told() for _ in range(1000)]
    slave._contexts.update(enumerate(contexts))
    most, now_us = [], 0
    slave._notify = lambda context, *_: setattr(context, "count", context.count + 1)
    for each in contexts:
        each.state = SlaveState.OPEN
    slave._admission.takes_new = False
    for _ in range(60):
        before = sum(each.count for each in contexts)
        slave._tell_stop(now_us)
        most.append(sum(each.count for each in contexts) - before)
        now_us += SECOND // 2
    assert max(most) == NOTICES_AT_ONCE
    assert min(each.count for each in contexts) == 1
