"""A lost update is replaced after about one round trip, and never twice as fast as it can be acknowledged."""

import itertools

from hapticnet.protocol.repair import INITIAL_TIMEOUT_US, LONGEST_TIMEOUT_US, SHORTEST_TIMEOUT_US, Repair


def test_nothing_is_overdue_before_anything_was_sent_or_after_it_was_acknowledged():
    repair = Repair()
    assert not repair.expire(10**9)
    repair.sent(7, 0)
    repair.acknowledged(7, 1000)
    assert not repair.expire(10**9)


def test_an_older_acknowledgement_does_not_count_and_a_later_one_across_the_wrap_does():
    repair = Repair()
    repair.sent(0xFFFFFFFF, 0)
    repair.acknowledged(0xFFFFFFFE, 1000)
    assert repair.expire(INITIAL_TIMEOUT_US + 1)
    repair.sent(0, INITIAL_TIMEOUT_US + 1)
    repair.acknowledged(0, INITIAL_TIMEOUT_US + 2)
    assert not repair.expire(10**9)


def test_an_update_that_is_still_missing_is_not_forgotten_for_newer_ones():
    repair, now = Repair(), 0
    for sequence in range(60):
        repair.sent(sequence, now)
        repair.acknowledged(sequence, now + 40_000)
        now += 50_000
    lost_us = now
    for sequence in range(60, 69):
        assert not repair.expire(now)
        repair.sent(sequence, now)
        now += 5_000
    assert repair.expire(lost_us + 46_000)
    repair.sent(69, lost_us + 46_000)
    assert not repair.expire(lost_us + 46_000 + 80_000), "the repair is given a round trip, and longer than the first"
    repair.acknowledged(59, lost_us + 130_000)
    repair.acknowledged(69, lost_us + 130_000)
    assert not repair.expire(10**9)


def test_an_acknowledgement_covers_what_was_sent_before_it_and_of_the_rest_the_oldest_counts():
    repair = Repair()
    for sequence in range(10):
        repair.sent(sequence, 1000 * sequence)
    repair.acknowledged(4, 20_000)
    assert not repair.expire(5_000 + 3 * 16_000)
    assert repair.expire(5_000 + 3 * 16_000 + 1)


def test_it_recovers_until_something_sent_since_the_expiry_is_acknowledged():
    repair = Repair()
    for sequence in range(3):
        repair.sent(sequence, 1000 * sequence)
    assert not repair.recovering
    assert repair.expire(INITIAL_TIMEOUT_US + 1)
    repair.sent(3, INITIAL_TIMEOUT_US + 1)
    repair.sent(4, INITIAL_TIMEOUT_US + 2000)
    repair.acknowledged(2, INITIAL_TIMEOUT_US + 3000)
    assert repair.recovering
    repair.acknowledged(4, INITIAL_TIMEOUT_US + 4000)
    assert not repair.recovering


def test_a_number_that_was_never_sent_acknowledges_nothing():
    repair = Repair()
    repair.sent(7, 0)
    repair.acknowledged(8, 1000)
    assert repair.expire(INITIAL_TIMEOUT_US + 1)


def test_the_timeout_settles_near_one_round_trip():
    repair, now = Repair(), 0
    for sequence in range(60):
        repair.sent(sequence, now)
        repair.acknowledged(sequence, now + 40_000)
        now += 50_000
    repair.sent(60, now)
    assert not repair.expire(now + 40_000)
    assert repair.expire(now + 46_000)


def test_a_quick_link_is_given_the_shortest_timeout_and_a_dead_one_is_asked_ever_more_rarely():
    repair = Repair()
    for sequence in range(20):
        repair.sent(sequence, sequence)
        repair.acknowledged(sequence, sequence)
    repair.sent(20, 0)
    assert not repair.expire(SHORTEST_TIMEOUT_US)
    now, waits = 0, []
    for sequence in range(21, 33):
        start = now
        while not repair.expire(now):
            now += 1000
        waits.append(now - start)
        repair.sent(sequence, now)
    assert all(later >= earlier for earlier, later in itertools.pairwise(waits))
    assert waits[0] <= 2 * SHORTEST_TIMEOUT_US
    assert LONGEST_TIMEOUT_US <= waits[-1] <= 1.01 * LONGEST_TIMEOUT_US


def test_a_clock_that_goes_back_repairs_once_too_often_rather_than_never():
    repair = Repair()
    repair.sent(1, 10**10)
    assert repair.expire(0)
