"""A slave that is to stop takes no new masters, lets the present ones finish, and no force is cut off."""

import numpy as np
import pytest

from hapticnet.node.slave import NOTICES_AT_ONCE
from hapticnet.protocol.messages import Code
from hapticnet.protocol.states import Connected, Ended, MasterState, Noticed, Refused, SessionLost, SlaveState
from hapticnet.samples import PositionSample
from tests.conftest import linked, make_slave
from tests.peers import KEY, events_of

MS = 1000
SECOND = 1000 * MS


class Hand:
    axes, duration_us = 1, None

    def sample(self, t_us):
        return PositionSample(t_us, (0.024 + 0.002 * np.sin(2e-6 * np.pi * t_us),))


def told_link(sealed, seed=1):
    return linked(Hand(), seed=seed, key=KEY if sealed else None)


def test_a_running_master_is_told_and_keeps_its_force_until_it_has_finished(sealed):
    link = told_link(sealed)
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
    told = [each for each in events_of(link.master) if isinstance(each, Noticed)]
    assert [each.code for each in told] == [Code.STOPPING], "once, although the slave repeats it"
    assert link.master.session.received.by_kind[10] >= 2
    assert link.master.report()["notices"]
    link.close()
    assert link.slave.drained
    assert link.slave.report()["sessions"][0]["superseded"] == 0


def test_the_end_of_the_time_cuts_no_force(sealed):
    link = told_link(sealed)
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
    (lost,) = [each for each in events_of(link.master) if isinstance(each, SessionLost)]
    assert "shutting down" in lost.reason


def test_a_new_master_is_refused_with_a_reason_and_asks_again(sealed):
    link = told_link(sealed)
    link.run(100 * MS)
    link.slave.drain(link.now_us)
    link.slave.close("shutting down", link.now_us)
    late = told_link(sealed, 5)
    late.slave = link.slave
    late.now_us = late._next_tick_us = link.now_us
    late.run(4 * SECOND)
    found = events_of(late.master)
    assert not [each for each in found if isinstance(each, Ended | Connected)]
    refused = [each for each in found if isinstance(each, Refused)]
    assert {each.code for each in refused} == {Code.STOPPING}
    assert [each.retry_us for each in refused][:2] == [SECOND, 2 * SECOND]
    assert late.master.session.state is MasterState.CONNECTING
    late.slave = make_slave(sealed=None)  # the next one at this address
    late.run(6 * SECOND)
    assert late.master.connected


def test_a_running_master_may_change_its_codec_while_the_slave_waits(sealed):
    link = told_link(sealed)
    link.run(SECOND)
    link.slave.drain(link.now_us)
    link.master.change(codec="raw")
    link.run(SECOND)
    assert link.master.connections == 2
    assert link.master.codec.name == "raw"


@pytest.mark.plain
def test_a_thousand_masters_are_told_a_few_at_a_time():
    """Telling all of them at once would hold up the forces of each."""
    slave = make_slave(sealed=None)

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
