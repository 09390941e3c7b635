"""A lost update is replaced about a round trip later, whatever is sent meanwhile."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.admission import SlaveSettings
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode, MasterSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.wire import Kind, unpack
from hapticnet.samples import ForceSample, PositionSample

DELAY_US = 60_000
ROUND_TRIP_US = 2 * DELAY_US


class Resting:
    """An operator that does not move."""

    axes = 1
    duration_us = None

    def sample(self, elapsed_us):
        return PositionSample(elapsed_us, (0.0,))


class Stepping:
    """A scene whose force changes by more than a threshold every 5 to 35 ms."""

    name = "stepping"
    axes = 1
    breaches = 0

    def __init__(self):
        self._rng = np.random.default_rng(3)
        self._next_us = 0
        self.force_n = 1.0

    def step(self, sample):
        if sample.t_us >= self._next_us:
            self._next_us = sample.t_us + int(self._rng.integers(5_000, 35_000))
            self.force_n += 0.12 if self.force_n < 1.2 else -0.12
        return ForceSample(sample.t_us, (self.force_n,))


class Losing(Emulator):
    """A channel that also loses the FORCEs it is told to lose, and keeps all of them."""

    lose_next = 0
    forces = 0

    def push(self, packet, size, now_us):
        if unpack(packet).kind is Kind.FORCE:
            self.forces += 1
            if self.lose_next:
                self.lose_next -= 1
                return
        super().push(packet, size, now_us)


def link_with(codec, feedback="", forward="", **parameters):
    def channel(more, seed, kind=Emulator):
        return kind(parse_channel(f"delay={DELAY_US // 1000}ms{more}"), np.random.default_rng(seed))

    settings = MasterSettings(codec=codec, parameters=parameters)
    return Loopback(
        MasterNode(Resting(), None, settings, np.random.default_rng(1)),
        SlaveNode(lambda _: Stepping(), SlaveSettings(), np.random.default_rng(2)),
        forward=channel(forward, 4),
        feedback=channel(feedback, 5, Losing),
    )


def time_to_next_applied(link, limit_us=3_000_000):
    """Return how long no FORCE is applied from now on [µs]."""
    applied, start_us = link.master.session._newest_force, link.now_us
    while link.master.session._newest_force == applied and link.now_us < start_us + limit_us:
        link.run(500)
    return link.now_us - start_us


@pytest.mark.parametrize("absolute_every", [16, 127])
def test_one_lost_residual_is_repaired_within_two_round_trips_while_updates_go_on(absolute_every):
    link = link_with("least-squares", absolute_every=absolute_every)
    link.run(5_000_000)
    waits = []
    for _ in range(20):
        link.feedback.lose_next, before = 1, link.feedback.forces
        while link.feedback.lose_next:
            link.run(500)
        assert link.feedback.forces == before + 1
        link.run(DELAY_US)  # what was sent before the loss has arrived
        waits.append(DELAY_US + time_to_next_applied(link))
        link.run(1_000_000)
    assert max(waits) <= 2 * ROUND_TRIP_US


def test_residuals_get_through_a_fifth_of_loss():
    link = link_with("least-squares", ",loss=20%", ",loss=20%", absolute_every=127)
    link.run(20_000_000)
    received = link.master.report()["received"]
    assert received["malformed"] <= 0.45 * received["by_kind"]["force"], "refused, of those that arrived"


@pytest.mark.parametrize(("jitter", "most"), [("", 0.0), (",jitter=uniform:5ms", 0.005)])
@pytest.mark.parametrize("codec", ["deadband", "least-squares"])
def test_without_loss_next_to_nothing_is_repaired(codec, jitter, most):
    link = link_with(codec, jitter, jitter)
    link.run(1_000_000)
    session = link.slave.stations[0].session
    expire, expired = session.expire_update, []
    session.expire_update = lambda now_us: expired.append(expire(now_us)) or expired[-1]
    link.run(10_000_000)
    assert len(expired) > 9_000
    assert sum(expired) <= most * link.feedback.forces


def test_a_force_that_whole_updates_follow_costs_at_most_one_more_for_each_that_is_lost():
    perfect, lossy = link_with("deadband"), link_with("deadband", ",loss=20%")
    for link in (perfect, lossy):
        link.run(20_000_000)
    assert lossy.feedback.forces <= 1.2 * perfect.feedback.forces
