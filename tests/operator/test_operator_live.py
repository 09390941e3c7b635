"""The hand of a person: smooth, bounded in speed, held when it falls silent, withdrawn when it is gone."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.errors import SampleError, SettingsError
from hapticnet.operator.live import AT_REST_M, HandState, LiveHand, LiveHandSettings

TICK_US = 1000


class Person:
    """Moves a hand and samples it at 1 kHz."""

    def __init__(self) -> None:
        self.hand = LiveHand()
        self.t_us = 0
        self.path_m: list[float] = []

    def wait(self, seconds: float) -> "Person":
        for _ in range(round(seconds * 1e6 / TICK_US)):
            self.t_us += TICK_US
            self.path_m.append(self.hand.sample(self.t_us).position_m[0])
        return self

    def stay(self, position_m: float, seconds: float) -> "Person":
        for _ in range(round(seconds * 10)):
            self.hand.move((position_m,))
            self.wait(0.1)
        return self

    @property
    def speeds_m_per_s(self) -> np.ndarray:
        return np.abs(np.diff(self.path_m)) * 1e6 / TICK_US


def person_with_hand() -> Person:
    person = Person()
    person.hand.take()
    return person


def test_follows_the_hand_and_arrives_without_overshoot():
    person = person_with_hand().stay(0.03, 1.5)
    assert person.path_m[-1] == pytest.approx(0.03, abs=1e-6)
    assert max(person.path_m) <= 0.03 + 1e-12
    assert person.hand.state is HandState.LIVE


def test_trails_a_hand_of_constant_speed_by_two_time_constants():
    person = person_with_hand()
    speed_m_per_s = 0.04
    for tick in range(1000):
        person.hand.move((speed_m_per_s * tick * 1e-3,))
        person.wait(0.001)
    late_s = (speed_m_per_s * 0.999 - person.path_m[-1]) / speed_m_per_s
    assert late_s == pytest.approx(person.hand.settings.delay_us * 1e-6, abs=0.002)


def test_a_staircase_of_60_hz_comes_out_smooth():
    person = person_with_hand()
    for step in range(60):
        person.hand.move((0.04 * step / 60,))
        person.wait(1 / 60)
    speeds = person.speeds_m_per_s[400:900]
    assert np.ptp(speeds) < 0.2 * 0.04  # the staircase itself goes from 0 to 0.67 m/s and back


@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.integers(0, 30_000)), min_size=1, max_size=40))
@settings(max_examples=50, deadline=None)
def test_is_never_faster_than_its_bound_nor_outside_its_range(moves: list[tuple[float, int]]):
    hand = LiveHand()
    hand.take()
    t_us, (before_m,) = 0, hand.position_m
    fastest_m_per_us = hand.settings.speed_m_per_s * 1e-6
    for position_m, elapsed_us in moves:
        hand.move((position_m,))
        t_us += elapsed_us
        (after_m,) = hand.sample(t_us).position_m
        assert abs(after_m - before_m) <= fastest_m_per_us * elapsed_us + 1e-12
        assert hand.range_m[0] - 1e-12 <= after_m <= hand.range_m[1] + 1e-12
        before_m = after_m


def test_a_silent_hand_stops_where_it_is_and_goes_on_when_it_speaks_again():
    person = person_with_hand()
    person.hand.move((0.05,))  # it needs 0.9 s for this
    person.wait(0.3)
    moving_m = person.path_m[-1]
    person.wait(0.5)
    assert person.hand.state is HandState.HOLDING
    assert 0 < person.path_m[-1] - moving_m < 0.003
    assert person.speeds_m_per_s[-1] < 1e-6
    assert min(np.diff(person.path_m)) >= 0  # it does not come back
    person.stay(0.04, 1.0)
    assert person.hand.state is HandState.LIVE
    assert person.path_m[-1] == pytest.approx(0.04, abs=1e-6)


def test_a_hand_that_stays_silent_is_withdrawn_and_free():
    person = person_with_hand().stay(0.05, 1.5).wait(1.2)
    assert person.hand.state is HandState.WITHDRAWING
    person.hand.move((0.05,))  # too late: it must be taken again
    person.wait(1.5)
    assert person.hand.state is HandState.FREE
    assert person.path_m[-1] == 0.0
    assert person.speeds_m_per_s.max() <= 0.06 + 1e-9


def test_a_release_withdraws_at_the_bounded_speed_until_the_hand_is_taken_again():
    person = person_with_hand().stay(0.05, 1.5)
    person.hand.release()
    taken_m = person.wait(0.5).path_m[-1]
    assert taken_m == pytest.approx(0.05 - 0.06 * 0.5, abs=0.003)
    person.hand.take()
    person.wait(0.2)
    assert person.hand.state is HandState.LIVE
    assert 0 <= taken_m - person.path_m[-1] < 0.003
    person.hand.release()
    assert person.wait(1.0).hand.state is HandState.FREE


def test_a_hand_nobody_took_does_not_move():
    person = Person()
    person.hand.move((0.05,))
    assert person.wait(0.1).path_m == [0.0] * 100
    assert person.hand.state is HandState.FREE


def test_a_pause_of_the_samples_is_no_jump():
    person = person_with_hand()
    person.hand.move((0.05,))
    person.wait(0.1)
    before_m = person.path_m[-1]
    person.hand.move((0.05,))
    after_m = person.hand.sample(person.t_us + 3_000_000).position_m[0]
    assert 0 < after_m - before_m <= 0.06 * 0.02 + 1e-12
    assert person.hand.sample(0).position_m[0] == after_m  # nor a clock that goes back


def test_a_new_range_is_reached_at_the_bounded_speed():
    person = person_with_hand().stay(0.08, 2.0)
    person.hand.set_range(-0.01, 0.05)
    person.stay(0.08, 2.0)
    assert person.path_m[-1] == pytest.approx(0.05, abs=1e-6)
    person.hand.release()
    person.wait(2.0)
    assert person.path_m[-1] == pytest.approx(-0.01, abs=AT_REST_M)
    assert person.speeds_m_per_s.max() <= 0.06 + 1e-9


def test_settings_out_of_range_and_nan_are_refused_and_change_nothing():
    for wrong in ({"speed_m_per_s": math.nan}, {"time_constant_us": 0}, {"deepest_m": -1.0}):
        with pytest.raises(SettingsError, match="must be between"):
            LiveHandSettings(**wrong)
    person = person_with_hand().stay(0.03, 1.0)
    with pytest.raises(SettingsError, match="must not be empty"):
        person.hand.set_range(0.1, 0.1)
    with pytest.raises(SampleError, match="NaN"):
        person.hand.move((math.nan,))
    assert person.wait(0.1).path_m[-1] == pytest.approx(0.03, abs=1e-4)


def test_a_scene_that_begins_anew_finds_the_needle_at_rest_though_its_time_begins_again():
    person = person_with_hand().stay(0.05, 2.0)
    person.hand.restart(-0.01, 0.06)
    assert (person.hand.state, person.hand.position_m) == (HandState.FREE, (-0.01,))
    person.t_us = 0
    person.wait(0.5)
    assert person.path_m[-1] == -0.01
    person.hand.take()
    person.stay(0.02, 2.0)
    assert person.path_m[-1] == pytest.approx(0.02, abs=1e-6)
    person.wait(2.0)  # it falls silent
    assert person.hand.state in (HandState.WITHDRAWING, HandState.FREE)


@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 3), min_size=1, max_size=20))
def test_a_hand_of_three_axes_keeps_its_path_within_speed_and_range(moves):
    hand = LiveHand(LiveHandSettings(axes=3, reach_m=0.03))
    hand.take()
    t_us, before_m = 0, hand.position_m
    for wanted_m in moves:
        hand.move(wanted_m)
        for _ in range(30):
            t_us += TICK_US
            after_m = hand.sample(t_us).position_m
            assert math.dist(after_m, before_m) <= 0.06 * 1e-3 + 1e-9
            assert 0.0 <= after_m[0] <= 0.1
            assert max(map(abs, after_m[1:])) <= 0.03
            before_m = after_m
    with pytest.raises(SampleError, match="1 axis; it must have 3"):
        hand.move((0.01,))
