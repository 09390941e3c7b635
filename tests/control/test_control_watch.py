"""Detection of faulty sensors, and fingers that must not look like one."""

import pytest

from hapticnet.control.force import ANSWER_N, JUMP_N, SensorWatch

PERIODS = 200


def moving(watch: SensorWatch, *, from_m: float, speed_m: float, force_n: float, rise_n_m: float) -> int | None:
    """Return the number of periods until detection; the force rises by `rise_n_m` per metre."""
    for period in range(PERIODS):
        way_m = speed_m * period
        if watch.check(True, force_n + rise_n_m * way_m, from_m + way_m, 1e-3):
            return period
    return None


@pytest.mark.parametrize("speed_m", [1e-4, -1e-4])
def test_a_constant_reading_during_motion_is_detected_after_about_a_newton(speed_m: float) -> None:
    noticed = moving(SensorWatch(), from_m=0.003, speed_m=speed_m, force_n=1.0, rise_n_m=0.0)
    assert noticed is not None
    assert 0.5e-3 < noticed * abs(speed_m) < 1.5e-3


@pytest.mark.parametrize("stiffness_n_m", [200.0, 1000.0, 3000.0])
def test_a_changing_reading_is_not_a_stuck_sensor(stiffness_n_m: float) -> None:
    assert moving(SensorWatch(), from_m=0.003, speed_m=1e-5, force_n=0.5, rise_n_m=stiffness_n_m) is None


def test_a_constant_reading_at_rest_is_not_a_fault() -> None:
    watch = SensorWatch()
    assert not any(watch.check(True, 1.0, 0.003, 1e-3) for _ in range(10_000))


def test_no_touch_is_not_a_fault() -> None:
    watch = SensorWatch()
    assert not any(watch.check(False, 0.0, 1e-4 * period, 1e-3) for period in range(PERIODS))


def test_a_change_of_the_reading_restarts_the_watch() -> None:
    watch = SensorWatch()
    for turn in range(20):
        force_n = 1.0 + 1.5 * ANSWER_N * (turn % 2)
        assert not any(watch.check(True, force_n, 1e-3 * turn + 1e-5 * step, 1e-3) for step in range(45))


@pytest.mark.parametrize("jump_n", [2.0 * JUMP_N, 3.0])
def test_an_oscillating_force_is_an_open_input(jump_n: float) -> None:
    watch = SensorWatch()
    complaints = [watch.check(True, 1.0 + jump_n * (period % 2), 0.003, 1e-3) for period in range(10)]
    assert complaints[:4] == [None] * 4
    assert complaints[4] is not None
    assert "connected" in complaints[4]


def test_occasional_jumps_are_not_an_open_input() -> None:
    watch = SensorWatch()
    forces_n = [1.0 + 2.0 * (period % 20 == 0) for period in range(1_000)]
    assert not any(watch.check(True, force_n, 0.003, 1e-3) for force_n in forces_n)


def test_a_constant_reading_limits_the_motion_of_the_platform() -> None:
    watch = SensorWatch()
    watch.check(True, 1.0, 0.003, 1e-3)
    assert 0.003 + 0.5e-3 < watch.furthest_m < 0.003 + 1.2e-3
    watch.check(False, 0.0, 0.003, 1e-3)
    watch.release()
    assert watch.furthest_m == float("inf")


def test_after_an_unexplained_fall_the_platform_goes_no_further_until_release() -> None:
    watch = SensorWatch()
    for _ in range(20):
        watch.check(True, 3.0, 0.004, 1e-3)
    assert not watch.fallen
    watch.check(True, 1.0, 0.004, 1e-3)
    assert watch.fallen
    assert watch.furthest_m == 0.004
    watch.check(True, 3.0, 0.004, 1e-3)
    assert watch.furthest_m == 0.004
    watch.release()
    assert not watch.fallen
    assert watch.furthest_m > 0.004


def test_a_fall_during_retreat_is_expected() -> None:
    watch = SensorWatch()
    for period in range(20):
        watch.check(True, 4.0 - 0.9 * max(0, period - 16), 0.004 - 0.3e-3 * max(0, period - 16), 1e-3)
    assert not watch.fallen


def test_a_force_that_spreads_within_a_period_while_the_platform_rests_is_an_open_input() -> None:
    """Mains hum with a period of two control periods gives equal means but different readings."""
    watch = SensorWatch()
    complaints = [watch.check(True, 1.0, 0.003, 1e-3, spread_n=2.0 * JUMP_N) for _ in range(5)]
    assert complaints[:2] == [None] * 2
    assert complaints[2] is not None


def test_a_stiff_finger_pressed_fast_has_the_same_spread_without_a_fault() -> None:
    watch = SensorWatch()
    for period in range(20):
        assert watch.check(True, 0.2 + 0.2 * period, 0.003 + 0.6e-3 * period, 1e-3, spread_n=2.0) is None
