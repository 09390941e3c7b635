"""A link whose round trip is near the largest age of an answered position: what the master says, asks and applies."""

import pytest

from hapticnet.node.events import SettingsInForce
from hapticnet.protocol.states import Connected, LinkRecovered, LinkStale
from hapticnet.protocol.wire import Kind, unpack

SECOND = 1_000_000


def play(loopback, round_trip_ms, seconds=20):
    delay = f"delay={round_trip_ms / 2}ms"
    link = loopback(forward=delay, feedback=delay)
    link.run(seconds * SECOND)
    events = []
    while (event := link.master.next_event()) is not None:
        if not isinstance(event, SettingsInForce):
            events.append(event)
    return link, events


def test_a_link_within_the_largest_age_works(loopback):
    link, events = play(loopback, 980)
    assert [type(event) for event in events] == [Connected, LinkStale, LinkRecovered]
    assert link.master.report()["received"]["too_old"] == 0
    assert link.slave.contexts[0].scene.breaches > 0


@pytest.mark.parametrize("round_trip_ms", [1020, 1200, 1300, 2500])
def test_a_link_beyond_it_is_named_and_neither_felt_nor_asked_for_again_and_again(loopback, round_trip_ms):
    link, events = play(loopback, round_trip_ms)
    assert [type(event) for event in events] == [Connected, LinkStale, LinkStale]
    assert events[-1].too_old_us == pytest.approx(round_trip_ms * 1000, abs=2000)
    report = link.master.report()
    assert report["connections"] == 1
    assert report["received"]["too_old"] > 100
    assert report["age_of_applied_force"]["count"] == 0
    assert link.master.held_force_n(20 * SECOND)[0] == 0.0


@pytest.mark.plain
def test_copies_of_an_old_answer_do_not_pass_for_a_slow_link(loopback):
    link, _ = play(loopback, 2, seconds=1)
    kept = []
    receive = link.master.receive_datagram
    link.master.receive_datagram = lambda data, now_us: (kept.append(data), receive(data, now_us))
    link.run(2 * SECOND)
    del link.master.receive_datagram
    link.master.datagrams_to_send()
    asked_us = []
    for now_us in range(3 * SECOND, 9 * SECOND, 1000):  # the slave is gone; somebody repeats what it said
        link.master.tick(now_us)
        link.master.receive_datagram(kept[-1], now_us)
        asked_us += [now_us for data in link.master.datagrams_to_send() if unpack(data).kind is Kind.HELLO]
    assert asked_us[0] == pytest.approx(4.2 * SECOND, abs=10_000)
    assert asked_us[-1] > 8 * SECOND
