"""An emulated channel whose settings change while packets are on their way."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel

SPECS = ["perfect", "delay=20ms", "loss=30%,delay=5ms", "delay=20ms,jitter=normal:5ms", "delay=1ms,reorder=10%"]


@pytest.mark.parametrize("before", SPECS)
@pytest.mark.parametrize("after", SPECS)
def test_every_packet_is_accounted_for_over_a_change(before, after):
    emulator = Emulator(parse_channel(before), np.random.default_rng(1))
    arrived = []
    for number in range(1000):
        if number == 500:
            emulator.change(parse_channel(after))
        emulator.push(number, 10, 1000 * number)
        arrived += emulator.due(1000 * number)
    arrived += emulator.due(10_000_000)
    counters = emulator.counters
    assert len(arrived) == len(set(arrived)) == counters.delivered
    assert counters.accepted == counters.delivered + counters.lost + counters.queue_dropped
    assert emulator.in_flight == 0


def test_packets_in_flight_arrive_as_planned():
    emulator = Emulator(parse_channel("delay=20ms"), np.random.default_rng(1))
    emulator.push("old", 10, 0)
    emulator.change(parse_channel("delay=5ms,reorder=10%"))
    assert emulator.due(19_999) == []
    assert emulator.due(20_000) == ["old"]


def test_other_delay_and_loss_count_from_the_next_packet():
    emulator = Emulator(parse_channel("perfect"), np.random.default_rng(1))
    emulator.change(parse_channel("delay=7ms"))
    emulator.push("late", 10, 0)
    assert (emulator.due(6_999), emulator.due(7_000)) == ([], ["late"])
    emulator.change(parse_channel("loss=100%"))
    emulator.push("lost", 10, 10_000)
    assert emulator.due(1_000_000) == []
    assert emulator.counters.lost == 1
