"""Sequence numbers: wrap, loss, reordering, duplicates."""

from hypothesis import given
from hypothesis import strategies as st

from hapticnet.protocol.stats import BEHIND_IN_A_ROW, LEAP, MISORDER, WINDOW, Arrival, ArrivalWindow
from hapticnet.protocol.wire import HALF, distance, unwrap, wrap

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


@given(numbers, st.integers(LEAP, HALF - 1))
def test_one_number_far_ahead_leaves_the_true_ones_new(first, leap):
    window = ArrivalWindow(first)
    assert window.arrive(wrap(first + leap)) is Arrival.ASTRAY
    assert [window.arrive(wrap(first + n)) for n in (1, 2, 3)] == [Arrival.NEW] * 3
    assert window.lost == 0


@given(numbers, st.integers(LEAP, HALF - 2))
def test_two_numbers_in_a_row_far_ahead_are_believed(first, leap):
    window = ArrivalWindow(first)
    window.arrive(wrap(first + leap))
    assert window.arrive(wrap(first + leap + 1)) is Arrival.NEW
    assert window.lost == leap


@given(numbers, st.integers(LEAP, HALF - 2))
def test_two_wrong_numbers_that_are_not_next_to_each_other_are_not(first, leap):
    window = ArrivalWindow(first)
    arrivals = [window.arrive(wrap(first + number)) for number in (leap, 1, leap + 1, 2)]
    assert arrivals == [Arrival.ASTRAY, Arrival.NEW, Arrival.ASTRAY, Arrival.NEW]
    assert window.lost == 0


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
