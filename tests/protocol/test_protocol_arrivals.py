"""Sequence numbers: wrap, loss, reordering, duplicates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.protocol.master_stream import Freshness
from hapticnet.protocol.messages import Force, Keepalive
from hapticnet.protocol.states import ForceArrived, HoldConfirmed, LinkRecovered, LinkStale, MasterState
from hapticnet.protocol.stats import (
    BEHIND_IN_A_ROW,
    LEAP,
    MISORDER,
    WINDOW,
    Arrival,
    ArrivalWindow,
    Distribution,
    Traffic,
)
from hapticnet.protocol.wire import HALF, Kind, distance, unwrap, wrap
from tests.peers import apply_forces, events_of
from tests.protocol.test_protocol_master_session import connected, send_position

numbers = st.integers(0, (1 << 32) - 1)


@given(numbers, st.integers(-HALF, HALF - 1))
def test_distance_undoes_addition_across_the_wrap(start, step):
    assert distance(wrap(start + step), start) == step


@given(st.integers(0, 1 << 50), st.integers(-HALF + 1, HALF - 1))
def test_unwrap_finds_the_number_near_the_last_one(near, step):
    assert unwrap(wrap(near + step), near) == near + step


@given(numbers, st.lists(st.integers(1, 200), max_size=60))
def test_new_lost_late_and_duplicate_add_up_wherever_the_numbers_start(first, order):
    """Against a set that remembers everything."""
    window, seen, newest = ArrivalWindow(first), {0}, 0
    for number in order:
        arrival = window.arrive(wrap(first + number))
        expected = Arrival.DUPLICATE if number in seen else Arrival.NEW if number > newest else Arrival.LATE
        assert arrival is expected
        seen.add(number)
        newest = max(newest, number)
        assert window.lost == newest + 1 - len(seen)


def test_what_is_older_than_the_window_is_late_and_loses_nothing_twice():
    window = ArrivalWindow(0)
    window.arrive(LEAP - 1)
    assert window.lost == LEAP - 2
    assert window.arrive(LEAP - 1 - WINDOW) is Arrival.LATE
    assert window.arrive(LEAP - 1 - WINDOW) is Arrival.LATE
    assert window.lost == LEAP - 2


NEW, ASTRAY = Arrival.NEW, Arrival.ASTRAY


@pytest.mark.parametrize(
    ("order", "arrivals"),
    [
        ((LEAP, 1, 2, 3), [ASTRAY, NEW, NEW, NEW]),
        ((LEAP, LEAP + 1), [ASTRAY, NEW]),
        ((LEAP, 1, LEAP + 1, 2), [ASTRAY, NEW, ASTRAY, NEW]),
    ],
    ids=["one is not believed", "two in a row are", "two with a true one between them are not"],
)
@given(numbers, st.integers(0, HALF - 2 - LEAP))
def test_numbers_far_ahead_are_believed_in_a_row(order, arrivals, first, further):
    window = ArrivalWindow(first)
    numbers = [number + further * (number >= LEAP) for number in order]
    assert [window.arrive(wrap(first + number)) for number in numbers] == arrivals
    assert window.lost == (numbers[0] if arrivals[1] is NEW and numbers[1] > LEAP else 0)


@given(numbers, st.integers(1, HALF - 2), st.integers(1, 2))
def test_there_is_a_way_back_from_wrong_numbers_after_the_disorder_that_a_network_causes(first, leap, wrong):
    window = ArrivalWindow(first)
    for number in range(leap, leap + wrong):
        window.arrive(wrap(first + number))
    tries = 1 + MISORDER + BEHIND_IN_A_ROW
    arrivals = [window.arrive(wrap(first + number)) for number in range(1, tries + 10)]
    assert set(arrivals[tries:]) == {Arrival.NEW}


@given(numbers, st.integers(MISORDER + 2 * BEHIND_IN_A_ROW, LEAP - 1))
def test_one_wrong_number_within_the_leap_costs_eight_true_ones(first, leap):
    window = ArrivalWindow(first)
    assert window.arrive(wrap(first + leap)) is Arrival.NEW
    arrivals = [window.arrive(wrap(first + number)) for number in range(1, 20)]
    late = arrivals.count(Arrival.LATE)
    assert late == BEHIND_IN_A_ROW - 1
    assert arrivals[late:] == [Arrival.NEW] * (19 - late)


@given(st.permutations(range(1, MISORDER + 1)))
def test_disorder_that_a_network_causes_never_moves_the_newest_number_back(order):
    window = ArrivalWindow(0)
    window.arrive(MISORDER + 1)
    assert {window.arrive(number) for number in order} == {Arrival.LATE}
    assert window.arrive(MISORDER + 2) is Arrival.NEW
    assert window.lost == 0


@given(st.lists(st.integers(0, LEAP - MISORDER - 10), min_size=8, max_size=30).map(lambda n: sorted(n, reverse=True)))
def test_numbers_far_behind_that_do_not_rise_are_copies_and_not_believed(order):
    window = ArrivalWindow(0)
    window.arrive(LEAP - 1)
    assert Arrival.NEW not in {window.arrive(number) for number in order}
    assert window.arrive(LEAP) is Arrival.NEW


@given(st.lists(st.integers(1, (1 << 32) - (1 << 16)), max_size=60))
def test_a_number_that_a_seal_proves_is_believed_at_once_and_nothing_older_ever_again(order):
    window, seen, newest = ArrivalWindow(0, authentic=True), {0}, 0
    for number in order:
        if abs(number - newest) >= HALF:
            continue
        arrival = window.arrive(number)
        if number > newest:
            assert arrival is Arrival.NEW
        else:
            remembered = number in seen and newest - number < WINDOW
            assert arrival is (Arrival.DUPLICATE if remembered else Arrival.LATE)
        seen.add(number)
        newest = max(newest, number)


def test_every_byte_is_accounted_for_with_and_without_headers():
    traffic = Traffic()
    traffic.open_window(0, authentic=False)
    traffic.add(Kind.FORCE, 27)
    traffic.add_malformed(100)
    account = traffic.report()
    assert account["packets"] == 2
    assert account["payload_bytes"] == 127
    assert account["wire_bytes"] == 127 + 2 * 28
    assert account["by_kind"] == {"force": 1}
    assert account["malformed"] == 1


def test_losses_add_up_over_sessions():
    traffic = Traffic()
    traffic.open_window(0, authentic=False)
    assert traffic.arrive(3) is Arrival.NEW
    traffic.open_window(0, authentic=False)
    arrivals = [traffic.arrive(sequence) for sequence in (2, 2, 1)]
    assert arrivals == [Arrival.NEW, Arrival.DUPLICATE, Arrival.LATE]
    account = traffic.report()
    assert (account["lost"], account["late"], account["duplicate"]) == (2, 1, 1)


@given(st.lists(st.integers(0, 10**7), min_size=1, max_size=200), st.sampled_from([50, 99, 99.9]))
def test_percentiles_are_within_a_bucket_of_the_sorted_list(values, percent):
    distribution = Distribution()
    for value in values:
        distribution.add(value)
    exact = float(np.percentile(values, percent, method="inverted_cdf"))
    assert distribution.percentile(percent) == pytest.approx(exact, rel=0.0101, abs=1.02)
    assert distribution.report()["max_us"] == max(values)


def test_an_empty_distribution_says_that_nothing_was_measured():
    assert Distribution().report() == {"count": 0, "p50_us": None, "p99_us": None, "p99_9_us": None, "max_us": None}


def test_any_number_of_durations_fit_in_a_bounded_number_of_buckets():
    distribution = Distribution()
    for value in np.random.default_rng(0).integers(-5, 10**7, 20_000).tolist():
        distribution.add(value)
    assert len(distribution._counts) < 1700


MAX_AGE_US = 1_000_000


@given(st.integers(0, 1 << 50), st.integers(-(10**7), 10**7))
def test_an_answer_is_fresh_if_its_position_was_sent_and_is_no_older_than_the_limit(sent_us, age_us):
    fresh = Freshness(MAX_AGE_US)
    fresh.newest_t_us = sent_us
    now_us = sent_us + age_us
    answered = fresh.fresh_t_us(wrap(sent_us), now_us, is_new=True)
    assert answered == (sent_us if age_us <= MAX_AGE_US else None)
    assert fresh.too_old_us == (None if age_us <= MAX_AGE_US else age_us)
    assert fresh.fresh_t_us(wrap(sent_us + 1), now_us, is_new=True) is None, "no such position was sent"
    assert fresh.too_old_us == (None if age_us <= MAX_AGE_US else age_us), "and its age means nothing"


def test_the_age_told_is_that_of_the_least_old_since_the_last_fresh_one():
    fresh = Freshness(MAX_AGE_US)
    fresh.newest_t_us = 0
    for now_us in (3_000_000, 2_000_000, 4_000_000):
        fresh.fresh_t_us(0, now_us, is_new=True)
    fresh.fresh_t_us(0, 1_500_000, is_new=False)
    assert fresh.too_old_us == 2_000_000
    fresh.heard(4_000_000)
    assert fresh.too_old_us is None


def test_a_clock_that_goes_back_does_not_shorten_a_silence():
    fresh = Freshness(MAX_AGE_US)
    fresh.heard(10_000_000)
    assert fresh.silent_us(4_000_000) == 0
    assert fresh.silent_us(5_000_000) == 1_000_000


@pytest.mark.parametrize("kind", [Kind.FORCE, Kind.KEEPALIVE])
def test_an_answer_to_an_old_position_or_to_none_is_counted_and_nothing_else(sealed, kind):
    session, slave = connected(sealed, now_us=10_000_000)
    for t_us in range(10_000_000, 13_000_000, 1000):
        session.send_position(t_us, b"abcd")
    now_us = 13_000_000

    def answer(sequence, t_us):
        message = Force(t_us, b"abcd") if kind is Kind.FORCE else Keepalive(t_us, None)
        slave.say(kind, sequence, message, now_us)
        return events_of(session)

    for sequence, t_us in enumerate((11_999_999, 10_000_000, 0, 12_999_001, 13_000_000, 99_000_000), start=1):
        assert answer(sequence, t_us) == []
        assert session.received.too_old == sequence
    assert session.round_trip.count == 0
    (event,) = answer(7, 12_000_000)
    assert event == (ForceArrived(7, 12_000_000, b"abcd") if kind is Kind.FORCE else HoldConfirmed(12_000_000))
    assert session.received.too_old == 6


def test_old_answers_are_no_sign_of_life_and_the_stale_link_names_their_age(sealed):
    """A slave that wakes up, or a network that held everything back: the forces of 1.5 s ago, at their own pace."""
    session, slave = connected(sealed)
    found = []
    for now_us in range(0, 3_000_000, 1000):
        session.tick(now_us)
        session.send_position(now_us, b"abcd")
        if now_us >= 1_600_000:
            slave.say(Kind.FORCE, now_us // 1000, Force(now_us - 1_500_000, b"abcd"), now_us)
        found += [(now_us, event) for event in apply_forces(session)]
    assert found == [(201_000, LinkStale(None)), (1_600_000, LinkStale(1_500_000))]
    assert session.state is MasterState.STALE
    assert session.received.too_old == 1400


def test_a_link_that_is_too_slow_is_stale_with_the_age_of_its_least_old_answer(sealed):
    start = 10_000_000
    session, slave = connected(sealed, now_us=start)
    for step, age_us in enumerate((1_900_000, 1_300_000, 1_700_000), start=1):
        slave.say(Kind.KEEPALIVE, step, Keepalive(start + 100_000 - age_us, None), start + 100_000)
    session.tick(start + 200_001)
    assert events_of(session) == [LinkStale(1_300_000)]
    slave.say(Kind.KEEPALIVE, 4, Keepalive(start, None), start + 310_000)
    assert events_of(session)[0] == LinkRecovered()
    session.tick(start + 600_000)
    assert events_of(session) == [LinkStale(None)], "nothing arrived since"


def test_a_late_datagram_is_no_sign_of_life_though_its_force_is_news(sealed):
    session, slave = connected(sealed)
    send_position(session, slave, 150_000)
    slave.say(Kind.KEEPALIVE, 5, Keepalive(0, 4), 1000)
    session.tick(150_000)
    slave.say(Kind.FORCE, 4, Force(140_000, b"late"), 190_000)
    assert apply_forces(session) == [ForceArrived(4, 140_000, b"late")]
    slave.say(Kind.KEEPALIVE, 3, Keepalive(150_000, None), 195_000)
    session.tick(201_001)
    assert events_of(session) == [LinkStale()]
    slave.say(Kind.FORCE, 2, Force(150_000, b"later"), 202_000)
    assert session.state is MasterState.STALE


def test_a_slower_link_is_used_where_the_limit_allows_it(sealed):
    session, slave = connected(sealed, max_age_us=3_000_000)
    slave.say(Kind.FORCE, 1, Force(0, b"abcd"), 2_900_000)
    assert events_of(session) == [ForceArrived(1, 0, b"abcd")]
