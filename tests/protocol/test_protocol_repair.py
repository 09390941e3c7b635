"""A lost update is replaced after about one round trip; with loss it is repeated before, and silences are shortened."""

import itertools

import numpy as np
import pytest

from hapticnet.channel.settings import GilbertElliottLoss
from hapticnet.perception import WeberLaw
from hapticnet.protocol.repair import (
    INITIAL_TIMEOUT_US,
    LONGEST_TIMEOUT_US,
    MOST_CREDIT,
    REPORT_LASTS_US,
    SHORTEST_TIMEOUT_US,
    Repair,
)
from hapticnet.protocol.settings import RepairSettings, SessionSettings
from hapticnet.protocol.stats import MEMORY, NO_LOSS, Loss, LossEstimate, datagrams_needed
from hapticnet.protocol.wire import wrap

HELD = (1.0,)
JND_N = WeberLaw().jnd_n(1.0)
LAW = WeberLaw()


def make_repair(**settings):
    return Repair(SessionSettings(repair=RepairSettings(**settings)), LAW, 0)


def settled(round_trip_us=40_000, loss=None, **settings):
    """Return a repair that knows the round trip, everything acknowledged, and the time."""
    repair, now_us = make_repair(**settings), 0
    for sequence in range(60):
        repair.sent(sequence, now_us, HELD)
        repair.acknowledged(sequence, now_us + round_trip_us)
        now_us += 50_000
    if loss is not None:
        repair.reported(loss, now_us)
    return repair, now_us


def due_times_us(repair, now_us, stimulus, *, sequence=60, duration_us=44_000, before=HELD):
    """Send an update, then the stimulus whenever it is due, at 1 kHz; return when, counted from the update."""
    repair.sent(sequence, now_us, before)
    repair.spoke(now_us)
    times_us = []
    for after_us in range(1000, duration_us, 1000):
        if repair.is_due(now_us + after_us, stimulus):
            sequence += 1
            repair.sent(sequence, now_us + after_us, stimulus)
            repair.spoke(now_us + after_us)
            times_us.append(after_us)
    return times_us


def test_nothing_is_overdue_before_anything_was_sent_or_after_it_was_acknowledged():
    repair = make_repair()
    assert not repair.is_due(10**9, HELD)
    repair.sent(7, 0, HELD)
    repair.acknowledged(7, 1000)
    assert not repair.is_due(10**9, HELD)


def test_an_older_acknowledgement_does_not_count_and_a_later_one_across_the_wrap_does():
    repair = make_repair()
    repair.sent(0xFFFFFFFF, 0, HELD)
    repair.acknowledged(0xFFFFFFFE, 1000)
    assert repair.is_due(INITIAL_TIMEOUT_US + 1, HELD)
    repair.sent(0, INITIAL_TIMEOUT_US + 1, HELD)
    repair.acknowledged(0, INITIAL_TIMEOUT_US + 2)
    assert not repair.is_due(10**9, HELD)


def test_an_update_that_is_still_missing_is_not_forgotten_for_newer_ones():
    repair, now = settled(40_000)
    lost_us = now
    for sequence in range(60, 69):
        assert not repair.is_due(now, HELD)
        repair.sent(sequence, now, HELD)
        now += 5_000
    assert repair.is_due(lost_us + 46_000, HELD)
    repair.sent(69, lost_us + 46_000, HELD)
    assert not repair.is_due(lost_us + 46_000 + 80_000, HELD), "the repair is given longer than the first"
    repair.acknowledged(59, lost_us + 130_000)
    repair.acknowledged(69, lost_us + 130_000)
    assert not repair.is_due(10**9, HELD)


def test_an_acknowledgement_covers_what_was_sent_before_it_and_of_the_rest_the_oldest_counts():
    repair = make_repair()
    for sequence in range(10):
        repair.sent(sequence, 1000 * sequence, HELD)
    repair.acknowledged(4, 20_000)
    assert not repair.is_due(5_000 + 3 * 16_000, HELD)
    assert repair.is_due(5_000 + 3 * 16_000 + 1, HELD)


def test_updates_are_complete_until_something_sent_since_the_expiry_is_acknowledged():
    repair = make_repair()
    for sequence in range(3):
        repair.sent(sequence, 1000 * sequence, HELD)
    assert not repair.complete
    assert repair.is_due(INITIAL_TIMEOUT_US + 1, HELD)
    repair.sent(3, INITIAL_TIMEOUT_US + 1, HELD)
    repair.sent(4, INITIAL_TIMEOUT_US + 2000, HELD)
    repair.acknowledged(2, INITIAL_TIMEOUT_US + 3000)
    assert repair.complete
    repair.acknowledged(4, INITIAL_TIMEOUT_US + 4000)
    assert not repair.complete


def test_a_number_that_was_never_sent_acknowledges_nothing():
    repair = make_repair()
    repair.sent(7, 0, HELD)
    repair.acknowledged(8, 1000)
    assert repair.is_due(INITIAL_TIMEOUT_US + 1, HELD)


def test_the_timeout_settles_near_one_round_trip():
    repair, now = settled(40_000)
    repair.sent(60, now, HELD)
    assert not repair.is_due(now + 40_000, HELD)
    assert repair.is_due(now + 46_000, HELD)


def test_a_quick_link_is_given_the_shortest_timeout_and_a_dead_one_is_asked_ever_more_rarely():
    repair = make_repair()
    for sequence in range(20):
        repair.sent(sequence, sequence, HELD)
        repair.acknowledged(sequence, sequence)
    repair.sent(20, 0, HELD)
    assert not repair.is_due(SHORTEST_TIMEOUT_US, HELD)
    now, waits = 0, []
    for sequence in range(21, 33):
        start = now
        while not repair.is_due(now, HELD):
            now += 1000
        waits.append(now - start)
        repair.sent(sequence, now, HELD)
    assert all(later >= earlier for earlier, later in itertools.pairwise(waits))
    assert waits[0] <= 2 * SHORTEST_TIMEOUT_US
    assert LONGEST_TIMEOUT_US <= waits[-1] <= 1.01 * LONGEST_TIMEOUT_US


def test_a_clock_that_goes_back_repairs_once_too_often_rather_than_never():
    repair = make_repair()
    repair.sent(1, 10**10, HELD)
    assert repair.is_due(0, HELD)


def test_without_reported_loss_nothing_is_repeated_before_the_timeout():
    repair, now = settled(200_000)
    assert due_times_us(repair, now, (5.0,)) == []
    assert repair.keepalive_us == 45_000
    assert not repair.complete


def test_an_update_is_repeated_while_the_doubt_is_above_the_limit_and_the_miss_above_a_jnd():
    loss = Loss(0.1, 0.1)
    for miss, most in ((0.9, 0), (1.1, 1), (20.0, 1)):
        repair, now = settled(200_000, loss, paces=False)
        assert len(due_times_us(repair, now, (1.0 + miss * JND_N,))) == most, "one repeat leaves a doubt of 1 %"
    repair, now = settled(200_000, Loss(0.1, 0.8), paces=False)
    assert len(due_times_us(repair, now, (2.0,))) == 8, "0.1 · 0.8⁸ is the first that is at most 2 %"


def test_large_changes_are_repeated_first():
    waits = []
    for miss in (1.2, 2.0, 50.0):
        repair, now = settled(200_000, Loss(0.1, 0.1), paces=False)
        waits += due_times_us(repair, now, (1.0 + miss * JND_N,))
    assert waits == [5000, 3000, 2000]


def test_what_is_acknowledged_is_not_repeated():
    repair, now = settled(200_000, Loss(0.1, 0.1))
    repair.sent(60, now, HELD)
    repair.acknowledged(60, now + 1000)
    assert not any(repair.is_due(now + after_us, (5.0,)) for after_us in range(1000, 20_000, 1000))


def test_repeats_are_bounded_by_the_positions_that_arrive():
    repair, now = settled(900_000, Loss(0.5, 0.99), paces=False)
    sequence, repeats = 60, 0
    for tick in range(900):
        stimulus = (1.0 + (tick % 2),)
        repair.reported(Loss(0.5, 0.99), now)
        if repair.is_due(now, stimulus):
            repeats += 1
            repair.spoke(now)
        sequence += 1
        if tick % 10 == 0:
            repair.sent(sequence, now, (5.0,))
            repair.spoke(now)
        now += 1000
    assert 100 < repeats <= RepairSettings().repeats_per_position * 900 + MOST_CREDIT + 1


def test_a_report_counts_for_a_second():
    repair, now = settled(200_000, Loss(0.3, 0.8))
    assert repair.keepalive_us < 10_000
    repair.sent(60, now + REPORT_LASTS_US + 1000, HELD)
    assert not repair.is_due(now + REPORT_LASTS_US + 5000, (2.0,))
    assert repair.keepalive_us == 45_000
    assert not repair.complete


def test_every_update_is_complete_while_there_is_loss():
    repair, now = settled(200_000, Loss(0.01, 0.0))
    assert repair.complete
    repair.reported(NO_LOSS, now)
    assert not repair.complete


@pytest.mark.parametrize("round_trip_us", [1000, 40_000, 100_000, 200_000])
@pytest.mark.parametrize("again", [0.1, 0.5, 0.8, 0.95])
def test_the_longest_silence_shortens_with_loss_and_burst_length_within_bounds(round_trip_us, again):
    paces = []
    for share in (0.0, 0.01, 0.05, 0.1, 0.3):
        repair, _ = settled(round_trip_us, Loss(share, again))
        paces.append(repair.keepalive_us)
    assert paces[0] == 45_000
    assert all(later <= earlier for earlier, later in itertools.pairwise(paces))
    assert paces[-1] >= RepairSettings().shortest_keepalive_us


def test_a_short_round_trip_needs_fewer_keepalives_because_a_loss_is_noticed_in_time():
    paces = [settled(round_trip_us, Loss(0.1, 0.8))[0].keepalive_us for round_trip_us in (1000, 40_000, 200_000)]
    assert paces == sorted(paces, reverse=True)
    assert paces[0] == 45_000 > 5 * paces[-1]


def test_after_a_known_loss_something_is_sent_until_one_of_it_is_sure_to_arrive():
    repair, now = settled(1000, Loss(0.1, 0.8))
    times_us = due_times_us(repair, now, HELD, duration_us=150_000)
    assert times_us[0] <= 7_000
    sent = np.array(times_us)
    assert all(
        np.count_nonzero((sent >= from_us) & (sent < from_us + 20_000)) >= 7 for from_us in range(0, 120_000, 20_000)
    )


@pytest.mark.parametrize(("share", "burst"), [(0.02, 1.25), (0.1, 1.2), (0.1, 5.0), (0.3, 5.0), (0.3, 2.0)])
def test_loss_and_burst_length_are_estimated_from_the_numbers_that_arrive(share, burst):
    chain = GilbertElliottLoss(p=share / burst / (1 - share), r=1 / burst)
    fates, estimate = chain.fates(np.random.default_rng(1)), LossEstimate(0xFFFFFFF0)
    seen = []
    for number in range(1, 20 * MEMORY):
        if not next(fates):
            estimate.arrived(wrap(0xFFFFFFF0 + number))
        if number % MEMORY == 0:
            seen.append(estimate.estimate())
    assert np.mean([loss.share for loss in seen]) == pytest.approx(share, rel=0.15, abs=0.005)
    assert np.mean([loss.again for loss in seen]) == pytest.approx(1 - 1 / burst, abs=0.08)


def heard(estimate, numbers):
    """Let numbers arrive; return the loss that is reported then."""
    for number in numbers:
        estimate.arrived(number)
    return estimate.estimate()


@pytest.mark.parametrize(
    ("known", "far", "following", "share"),
    [(1000, 1050, 1051, 0.05), (100, 2100, 100, 0.5)],
    ids=["after loss", "after a number that was wrong"],
)
def test_without_loss_nothing_is_reported_and_after_it_nothing_again(known, far, following, share):
    estimate = LossEstimate(0)
    assert heard(estimate, range(1, known)) is None
    estimate.arrived(far)
    estimate.arrived(following, is_new=True)
    assert heard(estimate, range(following + 1, following + 4)).share > share
    assert heard(estimate, range(following + 4, following + 8 * MEMORY)) is None


def test_datagrams_that_change_places_are_not_lost():
    order = [number + shuffled for number in range(1, 1000, 3) for shuffled in (2, 1, 0)]
    assert heard(LossEstimate(0), order) is None


def test_a_leap_of_numbers_takes_bounded_work():
    estimate = LossEstimate(0)
    estimate.arrived(2**30)
    assert estimate.estimate().share <= 1.0


@pytest.mark.parametrize("loss", [Loss(0.1, 0.1), Loss(0.1, 0.8), Loss(0.3, 0.8), Loss(0.3, 0.3)])
def test_the_number_of_datagrams_needed_keeps_silences_rare_in_a_simulated_chain(loss):
    window_us, per_s = 190_000, 1 / 20
    needed = datagrams_needed(loss, window_us, per_s)
    chain = GilbertElliottLoss(p=loss.share * (1 - loss.again) / (1 - loss.share), r=1 - loss.again)
    seconds = 2000
    datagrams = int(seconds * 1e6 / window_us * needed)
    lost = np.fromiter(itertools.islice(chain.fates(np.random.default_rng(2)), datagrams), dtype=bool)
    runs = np.diff(np.flatnonzero(np.diff(np.r_[0, lost.view(np.int8), 0])))[::2]
    assert np.count_nonzero(runs >= needed) <= 1.5 * per_s * seconds
