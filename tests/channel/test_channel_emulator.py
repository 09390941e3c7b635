import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.channel import emulator as emulator_module
from hapticnet.channel.emulator import HEADER_BYTES, Emulator
from hapticnet.channel.spec import PRESETS, parse_channel

EVERYTHING = (
    "delay=3ms,jitter=pareto:2ms,loss=gilbert:5%,30%,20%,99%,reorder=5%:4ms,duplicate=5%,rate=400kbit/s,queue=4ms"
)
SPECS = [
    "perfect",
    "delay=3ms",
    "delay=3ms,jitter=normal:1ms",
    "delay=3ms,jitter=uniform:2ms",
    "loss=20%,duplicate=10%",
    "delay=1ms,reorder=20%:2500us",
    "rate=300kbit/s,queue=3ms,duplicate=20%",
    "loss=100%",
    EVERYTHING,
    *PRESETS,
]
specs = st.sampled_from(SPECS)
seeds = st.integers(0, 2**32)
# Gaps between packets and their sizes: bursts, a 1 kHz stream, silence.
streams = st.lists(
    st.tuples(st.sampled_from([0, 1, 500, 1000, 20_000]) | st.integers(0, 5000), st.integers(0, 1472)), max_size=60
)


def make(spec, seed=7):
    return Emulator(parse_channel(spec), np.random.default_rng(seed))


def deliveries(emulator):
    """Take out all packets as (time of delivery, item)."""
    taken = []
    while (due_us := emulator.next_timer_us()) is not None:
        assert emulator.due(due_us - 1) == []
        items = emulator.due(due_us)
        assert items
        taken += [(due_us, item) for item in items]
    return taken


def send_all(emulator, stream, start_us=0):
    """Push a stream of (gap, size); return the packets as (time, size) by number."""
    sent = []
    now_us = start_us
    for gap_us, size_bytes in stream:
        now_us += gap_us
        emulator.push(len(sent), size_bytes, now_us)
        sent.append((now_us, size_bytes))
    return sent


def assert_conserved(emulator):
    counters = emulator.counters
    assert counters.accepted + counters.duplicated == (
        counters.delivered + counters.lost + counters.queue_dropped + emulator.in_flight
    )


@pytest.mark.parametrize(("spec", "delay_us"), [("perfect", 0), ("delay=20ms", 20_000), ("delay=1us,duplicate=1%", 1)])
def test_a_constant_delay_is_exact_to_the_microsecond_and_keeps_the_order_of_any_items(spec, delay_us):
    emulator, items = make(spec), [{"no": 1}, {"no": 2}]
    for item in items:
        emulator.push(item, 10, 5)
    assert emulator.in_flight == 2
    assert deliveries(emulator) == [(5 + delay_us, item) for item in items]
    assert emulator.in_flight == 0


@given(specs, seeds, streams, st.lists(st.integers(0, 60), max_size=5))
def test_every_packet_is_accounted_for_at_any_moment(spec, seed, stream, services):
    emulator = make(spec, seed)
    now_us = 0
    for number, (gap_us, size_bytes) in enumerate(stream):
        now_us += gap_us
        emulator.push(number, size_bytes, now_us)
        if number in services:
            emulator.due(now_us)
        assert_conserved(emulator)
    delivered_before = emulator.counters.delivered
    assert len(deliveries(emulator)) == emulator.counters.delivered - delivered_before
    assert emulator.in_flight == 0
    assert_conserved(emulator)
    counters = emulator.counters
    assert counters.accepted == len(stream)
    assert counters.accepted_bytes == sum(size_bytes + HEADER_BYTES for _, size_bytes in stream)
    assert counters.accepted_bytes + counters.duplicated_bytes == (
        counters.delivered_bytes + counters.lost_bytes + counters.queue_dropped_bytes
    )


@given(specs, seeds, streams)
def test_nothing_is_delivered_before_its_delay(spec, seed, stream):
    emulator = make(spec, seed)
    sent = send_all(emulator, stream)
    for due_us, number in deliveries(emulator):
        assert due_us >= sent[number][0] + parse_channel(spec).delay_us


@given(specs, seeds, streams)
def test_the_same_seed_gives_the_same_result_however_often_packets_are_taken_out(spec, seed, stream):
    at_the_end, at_once = make(spec, seed), make(spec, seed)
    send_all(at_the_end, stream)
    expected = deliveries(at_the_end)

    taken = []
    now_us = 0
    for number, (gap_us, size_bytes) in enumerate(stream):
        now_us += gap_us
        while (due_us := at_once.next_timer_us()) is not None and due_us <= now_us:
            taken += [(due_us, item) for item in at_once.due(due_us)]
        at_once.push(number, size_bytes, now_us)
    taken += deliveries(at_once)
    # Packets of the same microsecond: those already taken out cannot be ordered after a later one.
    assert sorted(taken) == sorted(expected)
    assert [due_us for due_us, _ in taken] == [due_us for due_us, _ in expected]


@pytest.mark.parametrize("spec", [spec for spec in SPECS if "reorder" not in spec])
@given(seed=seeds, stream=streams)
def test_packets_keep_their_order_by_default(spec, seed, stream):
    emulator = make(spec, seed)
    send_all(emulator, stream)
    numbers = [number for _, number in deliveries(emulator)]
    assert numbers == sorted(numbers)
    assert emulator.counters.reordered == 0


@given(seeds, streams)
def test_keeping_the_order_means_waiting_for_earlier_packets(seed, stream):
    emulator = make("delay=1ms,jitter=normal:3ms", seed)
    jitter_us = emulator.settings.jitter.delays_us(np.random.default_rng(seed).spawn(4)[2])
    own_us = [sent_us + 1000 + next(jitter_us) for sent_us, _ in send_all(emulator, stream)]
    assert [due_us for due_us, _ in deliveries(emulator)] == list(itertools.accumulate(own_us, max))


@given(seeds)
def test_a_held_back_packet_is_overtaken_and_delays_no_other(seed):
    emulator = make("delay=2ms,reorder=20%:3500us", seed)
    sent = send_all(emulator, [(1000, 20)] * 200)
    taken = deliveries(emulator)
    transits_us = {number: due_us - sent[number][0] for due_us, number in taken}
    assert set(transits_us.values()) == {2000, 5500}
    held = {number for number, transit_us in transits_us.items() if transit_us == 5500}
    assert 10 < len(held) < 80
    for kind in (held, transits_us.keys() - held):
        numbers = [number for _, number in taken if number in kind]
        assert numbers == sorted(numbers)


@pytest.mark.parametrize("copies", [1, 2])
def test_packets_that_are_all_held_back_and_duplicates_are_not_reordered(copies):
    emulator = make(f"reorder=100%:5ms,duplicate={copies - 1}")
    send_all(emulator, [(1000, 20)] * 20)
    assert [number for _, number in deliveries(emulator)] == [number for number in range(20) for _ in range(copies)]
    assert emulator.counters.reordered == 0


@pytest.mark.parametrize(
    "other", ["jitter=normal:3ms", "reorder=10%", "duplicate=10%", "delay=1s", "rate=1Gbit/s", EVERYTHING]
)
def test_the_same_packets_are_lost_whatever_else_the_channel_does(other):
    emulators = [
        make(f"{parts},loss=30%") for parts in ("delay=0ms", other.replace("loss=gilbert:5%,30%,20%,99%,", ""))
    ]
    arrived = []
    for emulator in emulators:
        # More than one block of random numbers.
        send_all(emulator, [(50_000, 20)] * 2500)
        arrived.append({number for _, number in deliveries(emulator)})
    assert arrived[0] == arrived[1]
    assert 1600 < len(arrived[0]) < 1900


def test_duplicates_follow_their_original_and_are_counted():
    emulator = make("delay=1ms,duplicate=30%")
    send_all(emulator, [(1000, 20)] * 1000)
    numbers = [number for _, number in deliveries(emulator)]
    counters = emulator.counters
    assert numbers == sorted(numbers)
    assert set(numbers) == set(range(1000))
    assert counters.duplicated == len(numbers) - 1000
    assert 240 < counters.duplicated < 360
    assert counters.duplicated_bytes == counters.duplicated * 48


def test_a_lost_packet_is_not_duplicated():
    emulator = make("loss=100%,duplicate=100%")
    send_all(emulator, [(1000, 20)] * 50)
    assert emulator.counters.lost == 50
    assert emulator.counters.duplicated == 0
    assert emulator.next_timer_us() is None


@given(seeds, streams, st.sampled_from([9_600, 300_000, 1_000_000, 7_777_777]))
def test_no_window_carries_more_than_the_rate_and_one_packet(seed, stream, rate_bit_per_s):
    emulator = make(f"delay=5ms,rate={rate_bit_per_s}bit/s,queue=50ms,duplicate=20%", seed)
    sent = send_all(emulator, stream)
    taken = [(due_us, (sent[number][1] + HEADER_BYTES) * 8) for due_us, number in deliveries(emulator)]
    for first in range(len(taken)):
        carried_bits = 0
        for due_us, bits in taken[first + 1 :]:
            carried_bits += bits
            # Times of delivery are rounded up to whole microseconds.
            window_us = due_us - taken[first][0] + 1
            assert carried_bits * 1_000_000 <= rate_bit_per_s * window_us


def test_the_bottleneck_takes_as_long_as_its_rate_says_headers_included():
    emulator = make("rate=1Mbit/s")
    emulator.push("a", 97, 0)
    emulator.push("b", 97, 0)
    assert deliveries(emulator) == [(1000, "a"), (2000, "b")]
    emulator = make("rate=3Mbit/s")
    emulator.push("a", 97, 0)
    assert emulator.next_timer_us() == 334


def test_a_bottleneck_is_never_faster_than_its_rate_however_small_the_fractions():
    emulator = make("rate=3Gbit/s")
    for number in range(10_000):
        emulator.push(number, 97, 0)
    taken = deliveries(emulator)
    assert taken[0][0] == 1
    # 10,000 packets of 1,000 bits take 3,333.3 µs.
    assert 3334 <= taken[-1][0] <= 3341


def test_a_full_queue_drops_the_newest_and_counts_them_and_empties_as_time_goes_on():
    emulator = make("rate=1Mbit/s,queue=3ms")
    send_all(emulator, [(1000, 97)] * 1000)
    assert emulator.counters.queue_dropped == 0
    assert [due_us for due_us, _ in deliveries(emulator)] == [1000 * (number + 2) for number in range(1000)]
    emulator = make("rate=1Mbit/s,queue=3ms")
    send_all(emulator, [(0, 97)] * 10)
    assert emulator.counters.queue_dropped == 6
    assert emulator.counters.queue_dropped_bytes == 6 * 125
    # One on the link, and three that wait for 1, 2 and 3 ms.
    assert deliveries(emulator) == [(1000, 0), (2000, 1), (3000, 2), (4000, 3)]


def test_a_packet_too_large_for_the_queue_still_passes_an_idle_link():
    emulator = make("rate=9600bit/s,queue=1ms")
    emulator.push("large", 1472, 0)
    assert deliveries(emulator) == [(1_250_000, "large")]


@pytest.mark.plain
@pytest.mark.parametrize("spec", ["perfect", "delay=1s,jitter=normal:1ms", "delay=1s,reorder=10%", EVERYTHING])
def test_an_emulator_that_is_never_emptied_is_bounded_and_counts_drops(monkeypatch, spec):
    monkeypatch.setattr(emulator_module, "MAX_IN_FLIGHT", 25)
    emulator = make(spec.replace("delay=3ms", "delay=1s"))
    send_all(emulator, [(10_000, 20)] * 100)
    assert emulator.in_flight == 25
    assert_conserved(emulator)
    assert emulator.counters.queue_dropped + emulator.counters.lost >= 75
    assert len(deliveries(emulator)) == 25


@given(specs, seeds, st.lists(st.integers(-(2**63), 2**63) | st.integers(0, 3000), max_size=40))
def test_clock_jumps_raise_nothing_and_keep_the_counters_right(spec, seed, times_us):
    emulator = make(spec, seed)
    for number, now_us in enumerate(times_us):
        emulator.push(number, 20, now_us)
        emulator.due(now_us - 500)
        assert_conserved(emulator)
    emulator.due(2**80)
    assert emulator.in_flight == 0
    assert_conserved(emulator)


def test_packets_stay_in_order_when_the_clock_steps_back():
    emulator = make("delay=1ms")
    emulator.push("a", 20, 5000)
    emulator.push("b", 20, 4000)
    assert emulator.due(5500) == []
    assert emulator.due(6000) == ["a", "b"]


def test_an_idle_channel_continues_at_once_after_the_clock_stepped_back():
    for spec in ("delay=1ms", "delay=1ms,jitter=uniform:1us", "delay=1ms,duplicate=1%,reorder=1%"):
        emulator = make(spec)
        emulator.push("a", 20, 10**12)
        assert "a" in emulator.due(10**12 + 20_000)
        emulator.push("b", 20, 0)
        assert "b" in emulator.due(20_000)


# Settings that change while packets are on their way ----------------------------------------------------------

CHANGES = ["perfect", "delay=20ms", "loss=30%,delay=5ms", "delay=20ms,jitter=normal:5ms", "delay=1ms,reorder=10%"]


@pytest.mark.parametrize("before", CHANGES)
@pytest.mark.parametrize("after", CHANGES)
def test_every_packet_is_accounted_for_over_a_change(before, after):
    emulator = make(before)
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


def test_other_settings_count_from_the_next_packet_and_packets_in_flight_arrive_as_planned():
    emulator = make("delay=20ms")
    emulator.push("old", 10, 0)
    emulator.change(parse_channel("delay=7ms,reorder=1e-9"))
    emulator.push("new", 10, 14_000)
    assert deliveries(emulator) == [(20_000, "old"), (21_000, "new")]
    emulator.change(parse_channel("loss=100%"))
    emulator.push("lost", 10, 30_000)
    assert emulator.due(1_000_000) == []
    assert emulator.counters.lost == 1
