"""Losses are repaired within two round trips, seldom release the finger, and cost bytes only while there are any."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.codec.registry import every_codec
from hapticnet.protocol.settings import RepairSettings, SessionSettings
from hapticnet.protocol.states import LinkStale
from hapticnet.protocol.wire import Kind, unpack
from hapticnet.samples import ForceSample
from tests.conftest import linked
from tests.peers import Still, events_of

CODECS = [name for name, codec in every_codec().items() if not codec.renders_model]
DELAY_US = 60_000
ROUND_TRIP_US = 2 * DELAY_US


class Stepping:
    """A scene whose force changes by more than a threshold every 5 to 35 ms."""

    name, axes, breaches = "stepping", 1, 0

    def __init__(self):
        self._rng = np.random.default_rng(3)
        self._next_us = 0
        self.force_n = 1.0

    def step(self, sample):
        if sample.t_us >= self._next_us:
            self._next_us = sample.t_us + int(self._rng.integers(5_000, 35_000))
            self.force_n += 0.12 if self.force_n < 1.2 else -0.12
        return ForceSample(sample.t_us, (self.force_n,))


class Constant:
    """A scene that presses with 1 N, so that only keepalives tell the link from a dead one."""

    name, axes, breaches = "constant", 1, 0

    def step(self, sample):
        return ForceSample(sample.t_us, (1.0,))


class Losing:
    """A channel that also loses the FORCEs it is told to lose, and counts all of them."""

    lose_next = 0
    forces = 0

    def __init__(self, settings, rng):
        self.channel = Emulator(settings, rng)
        self.due, self.next_timer_us = self.channel.due, self.channel.next_timer_us

    def push(self, packet, size, now_us):
        if unpack(packet).kind is Kind.FORCE:
            self.forces += 1
            if self.lose_next:
                self.lose_next -= 1
                return
        self.channel.push(packet, size, now_us)


def link_with(codec, feedback="", forward="", *, scene=Stepping, delay_us=DELAY_US, repair=None, seed=4, **parameters):
    delay, session = f"delay={delay_us // 1000}ms", SessionSettings(repair=repair or RepairSettings())
    settings = {"codec": codec, "parameters": parameters, "session": session}
    link = linked(Still(0.0), lambda _: scene(), delay + forward, seed=seed, slave={"session": session}, **settings)
    link.feedback = Losing(parse_channel(delay + feedback), np.random.default_rng(seed + 1))
    return link


def bursts(share, packets):
    """Return the loss of a channel as text: a mean share, in bursts of a mean length."""
    return f",loss=gilbert:{100 * share / (1 - share) / packets}%,{100 / packets}%"


def sent_bytes(link):
    """Return the bytes of both directions, with UDP and IPv4 headers."""
    return link.master.session.sent.wire_bytes + link.slave.contexts[0].session.sent.wire_bytes


def time_to_next_applied(link, limit_us=3_000_000):
    """Return how long no FORCE is applied from now on [µs]."""
    applied, start_us = link.master.session._stream.newest_force, link.now_us
    while link.master.session._stream.newest_force == applied and link.now_us < start_us + limit_us:
        link.run(500)
    return link.now_us - start_us


def recovery_times_us(link, losses, *, run=1):
    """Lose FORCEs at times, `run` in a row; return how long after each it takes until the master is right again."""
    link.run(5_000_000)
    waits = []
    for _ in range(losses):
        link.feedback.lose_next, before = run, link.feedback.forces
        while link.feedback.forces == before:
            link.run(500)
        link.run(DELAY_US)  # what was sent before the loss has arrived
        waits.append(DELAY_US + time_to_next_applied(link))
        link.run(1_000_000)
    return waits


@pytest.mark.parametrize("run", [1, 3])
@pytest.mark.parametrize("codec", CODECS)
def test_a_lost_update_of_any_codec_is_made_good_within_two_round_trips(codec, run):
    assert max(recovery_times_us(link_with(codec), 5, run=run)) <= 2 * ROUND_TRIP_US


def with_and_without_repair(codec, jitter="", **settings):
    """Return links that have run for ten seconds: one as it is, one that repairs nothing."""
    never = RepairSettings(replaces=False, repeats=False, paces=False)
    links = [link_with(codec, jitter, jitter, repair=repair, **settings) for repair in (None, never)]
    for link in links:
        link.run(10_000_000)
    return links


@pytest.mark.parametrize("codec", ["deadband", "least-squares", "adaptive-predictive"])
def test_without_loss_not_a_byte_more_is_sent(codec):
    # Before the first acknowledgement a round trip of at most 100 ms is assumed.
    repairing, other = with_and_without_repair(codec, delay_us=20_000)
    assert sent_bytes(repairing) == sent_bytes(other)


@pytest.mark.parametrize("codec", ["deadband", "least-squares"])
def test_jitter_causes_next_to_no_repairs(codec):
    repairing, other = with_and_without_repair(codec, ",jitter=uniform:5ms")
    assert repairing.feedback.forces <= 1.01 * other.feedback.forces


@pytest.mark.parametrize("burst", [1.2, 5.0])
def test_with_a_tenth_of_loss_at_most_15_percent_more_bytes_are_sent_in_both_directions(burst):
    loss = bursts(0.1, burst)
    perfect, lossy = link_with("deadband", delay_us=100_000), link_with("deadband", loss, loss, delay_us=100_000)
    for link in (perfect, lossy):
        link.run(30_000_000)
    assert sent_bytes(lossy) <= 1.15 * sent_bytes(perfect)


def test_whatever_is_lost_the_slave_sends_at_most_every_second_millisecond():
    loss = bursts(0.6, 20.0)
    link = link_with("deadband", loss, loss, delay_us=100_000)
    link.run(10_000_000)
    context = link.slave.contexts[0]
    assert context.session.sent.packets <= 0.5 * 10_000


@pytest.mark.parametrize(
    ("delay_ms", "burst", "jitter", "seed", "seconds"),
    [
        *((100, 5.0, "", seed, 150) for seed in (4, 14, 24, 34)),
        (20, 5.0, "", 4, 60),
        (50, 2.0, ",jitter=normal:5ms", 4, 60),
    ],
)
def test_three_tenths_of_loss_do_not_release_the_finger(delay_ms, burst, jitter, seed, seconds):
    # The links of 100 ms add up to ten minutes.
    loss = jitter + bursts(0.3, burst)
    link = link_with("deadband", loss, loss, scene=Constant, delay_us=1000 * delay_ms, seed=seed)
    link.run(5_000_000)  # the first losses are not known in advance
    events_of(link.master)
    released = 0
    for _ in range(50 * seconds):
        link.run(20_000)
        released += link.master.held_force_n(link.now_us)[0] < 1.0
    assert released == 0
    assert not any(isinstance(event, LinkStale) for event in events_of(link.master))
