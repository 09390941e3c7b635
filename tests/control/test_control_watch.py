"""A sensor that no longer answers or answers to nothing, and fingers that do."""

import pytest

from hapticnet.control.watch import ANSWER_N, LEAP_N, SensorWatch

PERIODS = 200


def moving(watch: SensorWatch, *, from_m: float, speed_m: float, force_n: float, rise_n_m: float) -> int | None:
    """Return after how many periods it was noticed; the force rises by `rise_n_m` per metre."""
    for period in range(PERIODS):
        way_m = speed_m * period
        if watch.notice(True, force_n + rise_n_m * way_m, from_m + way_m, 1e-3):
            return period
    return None


@pytest.mark.parametrize("speed_m", [1e-4, -1e-4])
def test_a_force_that_stays_while_the_platform_moves_is_noticed_after_about_a_newton_of_way(
    speed_m: float,
) -> None:
    noticed = moving(SensorWatch(), from_m=0.003, speed_m=speed_m, force_n=1.0, rise_n_m=0.0)
    assert noticed is not None
    assert 0.5e-3 < noticed * abs(speed_m) < 1.5e-3


@pytest.mark.parametrize("stiffness_n_m", [200.0, 1000.0, 3000.0])
def test_a_finger_that_answers_is_no_stuck_sensor(stiffness_n_m: float) -> None:
    assert moving(SensorWatch(), from_m=0.003, speed_m=1e-5, force_n=0.5, rise_n_m=stiffness_n_m) is None


def test_a_platform_at_rest_proves_nothing() -> None:
    watch = SensorWatch()
    assert not any(watch.notice(True, 1.0, 0.003, 1e-3) for _ in range(10_000))


def test_no_touch_is_no_fault() -> None:
    watch = SensorWatch()
    assert not any(watch.notice(False, 0.0, 1e-4 * period, 1e-3) for period in range(PERIODS))


def test_an_answer_starts_the_watch_anew() -> None:
    watch = SensorWatch()
    for turn in range(20):
        force_n = 1.0 + 1.5 * ANSWER_N * (turn % 2)
        assert not any(watch.notice(True, force_n, 1e-3 * turn + 1e-5 * step, 1e-3) for step in range(45))


@pytest.mark.parametrize("leap_n", [2.0 * LEAP_N, 3.0])
def test_a_force_that_leaps_forth_and_back_is_an_open_input(leap_n: float) -> None:
    watch = SensorWatch()
    complaints = [watch.notice(True, 1.0 + leap_n * (period % 2), 0.003, 1e-3) for period in range(10)]
    assert complaints[:4] == [None] * 4
    assert complaints[4] is not None
    assert "connected" in complaints[4]


def test_a_leap_now_and_then_is_none() -> None:
    watch = SensorWatch()
    forces_n = [1.0 + 2.0 * (period % 20 == 0) for period in range(1_000)]
    assert not any(watch.notice(True, force_n, 0.003, 1e-3) for force_n in forces_n)


def test_a_platform_is_not_sent_further_than_a_silent_sensor_bears() -> None:
    watch = SensorWatch()
    watch.notice(True, 1.0, 0.003, 1e-3)
    assert 0.003 + 0.5e-3 < watch.furthest_m < 0.003 + 1.2e-3
    watch.notice(False, 0.0, 0.003, 1e-3)
    watch.let_go()
    assert watch.furthest_m == float("inf")


def test_a_force_that_falls_by_itself_takes_the_platform_no_further_until_it_is_let_go() -> None:
    watch = SensorWatch()
    for _ in range(20):
        watch.notice(True, 3.0, 0.004, 1e-3)
    assert not watch.fallen
    watch.notice(True, 1.0, 0.004, 1e-3)
    assert watch.fallen
    assert watch.furthest_m == 0.004
    watch.notice(True, 3.0, 0.004, 1e-3)
    assert watch.furthest_m == 0.004
    watch.let_go()
    assert not watch.fallen
    assert watch.furthest_m > 0.004


def test_a_force_that_falls_because_the_platform_retreats_is_no_fall() -> None:
    watch = SensorWatch()
    for period in range(20):
        watch.notice(True, 4.0 - 0.9 * max(0, period - 16), 0.004 - 0.3e-3 * max(0, period - 16), 1e-3)
    assert not watch.fallen


def test_a_force_that_spreads_within_a_period_while_the_platform_rests_is_an_open_input() -> None:
    """Mains hum whose period is two control periods gives equal means, but not equal readings."""
    watch = SensorWatch()
    complaints = [watch.notice(True, 1.0, 0.003, 1e-3, spread_n=2.0 * LEAP_N) for _ in range(5)]
    assert complaints[:2] == [None] * 2
    assert complaints[2] is not None


def test_a_stiff_finger_pressed_fast_spreads_as_far() -> None:
    watch = SensorWatch()
    for period in range(20):
        assert watch.notice(True, 0.2 + 0.2 * period, 0.003 + 0.6e-3 * period, 1e-3, spread_n=2.0) is None
