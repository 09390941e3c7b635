"""Sequence numbers: wrap, loss, reordering, duplicates."""

from hypothesis import given
from hypothesis import strategies as st

from hapticnet.protocol.arrivals import LEAP, WINDOW, Arrival, ArrivalWindow
from hapticnet.protocol.serial_number import HALF, distance, unwrap, wrap

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
    window.arrive(5000)
    assert window.lost == 4999
    assert window.arrive(5000 - WINDOW) is Arrival.LATE
    assert window.arrive(5000 - WINDOW) is Arrival.LATE
    assert window.lost == 4999


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


@given(numbers, st.integers(LEAP, HALF - 2))
def test_there_is_a_way_back_from_two_wrong_numbers_in_a_row(first, leap):
    window = ArrivalWindow(first)
    for number in (leap, leap + 1):
        window.arrive(wrap(first + number))
    arrivals = [window.arrive(wrap(first + number)) for number in (1, 2, 3)]
    assert arrivals == [Arrival.ASTRAY, Arrival.NEW, Arrival.NEW]
