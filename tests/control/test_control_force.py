"""The controller alone, with an ideal finger or made-up readings. For tests with a device see test_node_fingertip."""

import dataclasses
import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.force import ANSWER_N, JUMP_N, ForceController, SensorWatch
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.errors import SettingsError

SETTINGS = ForceControlSettings()
TICK_US = 1_000
ANY = st.floats(allow_nan=True, allow_infinity=True)
ELAPSED_US = st.integers(0, 50_000) | st.integers(-(10**12), 10**12)  # gaps, and clocks that jump


def spring(stiffness_n_m: float, contact_m: float = 0.002) -> Callable[[float], float]:
    """An ideal finger without delay."""
    return lambda displacement_m: max(0.0, stiffness_n_m * (displacement_m - contact_m))


def run(
    controller: ForceController,
    target_n: float,
    sense: Callable[[float], float],
    *,
    start_us: int = 0,
    seconds: float = 3.0,
) -> list[float]:
    """Return the displacement [m] of each tick; the platform reaches it at the next tick."""
    displacement_m = controller.displacement_m
    trace = []
    for tick in range(int(seconds * 1e6) // TICK_US):
        displacement_m = controller.update(target_n, sense(displacement_m), displacement_m, start_us + tick * TICK_US)
        trace.append(displacement_m)
    return trace


@given(st.lists(st.tuples(ANY, ANY, ANY, st.integers(-(10**6), 10**6)), max_size=100))
def test_displacement_stays_within_the_travel_for_any_input(calls: list[tuple[float, float, float, int]]) -> None:
    controller = ForceController(SETTINGS)
    now_us = 0
    for target_n, sensed_n, stood_m, elapsed_us in calls:
        now_us += elapsed_us
        assert 0.0 <= controller.update(target_n, sensed_n, stood_m, now_us) <= SETTINGS.travel_m


@given(st.lists(st.tuples(ANY, ANY | st.none(), st.integers(1, 30)), max_size=30))
def test_nothing_that_is_asked_moves_the_platform_further_while_the_force_is_above_the_largest(
    asked: list[tuple[float, float | None, int]],
) -> None:
    controller = ForceController(SETTINGS)
    run(controller, 5.0, spring(2500.0), seconds=1.0)
    above_n, now_us = SETTINGS.max_force_n - SETTINGS.headroom_n + 0.05, 1_030_000
    before_m = run(controller, 5.0, lambda _: above_n, start_us=1_000_000, seconds=0.03)[-1]
    for target_n, ahead_n, ticks in [(2.0, 2.0, 1), (5.0, 5.0, 10), *asked]:
        for _ in range(ticks):
            now_us += TICK_US
            displacement_m = controller.update(target_n, above_n, before_m, now_us, ahead_n=ahead_n)
            assert displacement_m <= before_m
            if controller.fault:  # the platform went back and the reading stayed
                return
            before_m = displacement_m


@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 6.0), st.floats(0.0, 0.015), ELAPSED_US), max_size=100))
def test_never_moves_toward_the_finger_faster_than_the_press_speed(
    calls: list[tuple[float, float, float, int]],
) -> None:
    controller = ForceController(SETTINGS)
    now_us, before_m = 0, 0.0
    longest_s = 2e-6 * SETTINGS.period_us
    for target_n, sensed_n, stood_m, elapsed_us in calls:
        now_us += elapsed_us
        displacement_m = controller.update(target_n, sensed_n, stood_m, now_us)
        assert displacement_m - before_m <= SETTINGS.press_speed_m_s * longest_s + 1e-12
        before_m = displacement_m


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
@pytest.mark.parametrize("target_n", [0.5, 2.0, 4.5])
def test_the_loop_settles_on_the_target_for_any_finger(stiffness_n_m: float, target_n: float) -> None:
    finger = spring(stiffness_n_m)
    trace = run(ForceController(SETTINGS), target_n, finger)
    assert finger(trace[-1]) == pytest.approx(min(target_n, 0.0130 * stiffness_n_m), abs=0.1)


@pytest.mark.parametrize(
    ("sensed_n", "stood_m"),
    [(each, 0.003) for each in (math.nan, math.inf, -math.inf, 1e300, -1e300)]
    + [(1.0, each) for each in (math.nan, math.inf, -2.0)],
)
def test_a_reading_or_a_position_out_of_range_retracts_at_once(sensed_n: float, stood_m: float) -> None:
    controller = ForceController(SETTINGS)
    assert run(controller, 1.0, spring(1000.0))[-1] > 0.002
    assert controller.update(1.0, sensed_n, stood_m, 3_000_001) == 0.0


def test_a_target_that_is_not_finite_releases_the_finger() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 1.0, spring(1000.0))
    assert run(controller, math.nan, spring(1000.0), start_us=3_000_000)[-1] < 0.002


def test_calls_within_a_control_period_return_the_last_output() -> None:
    controller = ForceController(SETTINGS)
    trace = [controller.update(1.0, 0.0, 0.0, tick * TICK_US) for tick in range(100)]
    assert all(trace[tick] == trace[tick - tick % 10] for tick in range(100))
    assert len(set(trace)) == 10


def test_with_a_sensor_stuck_at_zero_the_platform_stays_within_the_reach() -> None:
    trace = run(ForceController(SETTINGS), 5.0, lambda _: 0.0, seconds=20.0)
    assert max(trace) == trace[-1] == SETTINGS.reach_m


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
def test_a_sensor_that_falls_silent_while_pressing_presses_little_more_than_the_search_force(
    stiffness_n_m: float,
) -> None:
    controller, finger = ForceController(SETTINGS), spring(stiffness_n_m)
    run(controller, 3.0, finger)
    trace = run(controller, 3.0, lambda _: 0.0, start_us=3_000_000, seconds=20.0)
    assert finger(trace[-1]) <= max(SETTINGS.search_n, SETTINGS.search_m * stiffness_n_m) + 0.7


def test_a_sensor_stuck_at_full_scale_retracts_fully() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 4.0, spring(1000.0))
    assert run(controller, 4.0, lambda _: 20.0, start_us=3_000_000)[-1] == 0.0


def test_a_frozen_sensor_is_detected_and_tried_again_after_release() -> None:
    controller = ForceController(SETTINGS)
    finger = spring(1000.0)
    run(controller, 2.0, finger)
    stuck = run(controller, 4.0, lambda _: 2.0, start_us=3_000_000)
    assert controller.fault is not None
    assert "stuck" in controller.fault
    assert max(map(finger, stuck)) <= 2.0 + 1.5
    assert stuck[-1] == 0.0
    run(controller, 0.0, finger, start_us=6_000_000, seconds=0.1)
    assert controller.fault is None
    assert finger(run(controller, 2.0, finger, start_us=7_000_000)[-1]) == pytest.approx(2.0, abs=0.04)


@pytest.mark.parametrize("factor", [0.2, 0.5, 0.8])
def test_after_a_partial_loss_of_force_the_platform_goes_no_further_until_release(factor: float) -> None:
    controller = ForceController(SETTINGS)
    finger = spring(1000.0)
    stood_m = run(controller, 3.0, finger)[-1]
    lost = run(controller, 3.0, lambda displacement_m: factor * finger(displacement_m), start_us=3_000_000)
    fell = factor < 0.7
    assert (max(lost) <= stood_m + 0.2e-3) == fell
    assert max(map(finger, lost)) <= 4.0
    let_go = run(controller, 0.0, lambda displacement_m: factor * finger(displacement_m), start_us=6_000_000)
    assert finger(let_go[-1]) < 0.1
    assert finger(run(controller, 2.0, finger, start_us=9_000_000)[-1]) == pytest.approx(2.0, abs=0.04)


def test_at_the_end_of_travel_nothing_winds_up() -> None:
    controller = ForceController(SETTINGS)
    soft = spring(250.0)
    trace = run(controller, 4.7, soft, seconds=60.0)
    assert trace[-1] == SETTINGS.travel_m
    after = run(controller, 0.5, soft, start_us=60_000_000, seconds=0.03)
    assert after[-1] < SETTINGS.travel_m


def test_a_target_below_the_threshold_is_set_by_the_model_of_the_finger() -> None:
    controller, finger = ForceController(SETTINGS), spring(1000.0)

    def deaf(displacement_m: float) -> float:
        return finger(displacement_m) * (finger(displacement_m) > SETTINGS.touch_n)

    run(controller, 2.0, deaf)
    trace = run(controller, 0.1, deaf, start_us=3_000_000)
    assert finger(trace[-1]) == pytest.approx(0.1, abs=0.1)
    assert len(set(trace[-1000:])) == 1


@pytest.mark.parametrize("target_n", [0.0, 0.05, 0.19])
def test_a_target_below_the_threshold_does_not_move_toward_an_unknown_finger(target_n: float) -> None:
    assert set(run(ForceController(SETTINGS), target_n, lambda _: 0.0, seconds=10.0)) == {0.0}


def test_without_a_target_the_platform_waits_just_before_the_finger() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 2.0, spring(1000.0))
    trace = run(controller, 0.0, spring(1000.0), start_us=3_000_000, seconds=10.0)
    assert 0.001 < trace[-1] < 0.002
    assert len(set(trace[50:])) == 1


def test_reset_retracts_and_starts_softly() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 2.0, spring(1000.0))
    controller.reset()
    trace = run(controller, 2.0, spring(1000.0), start_us=3_000_000, seconds=0.1)
    assert 0.0 < trace[-1] <= 0.1 * SETTINGS.approach_speed_m_s + 1e-12


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(ForceControlSettings) if f.name != "finger"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_refuses_bad_settings(field: str, value: float) -> None:
    with pytest.raises(SettingsError, match="must be between"):
        ForceControlSettings(**{field: value})


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


@pytest.mark.parametrize(
    "shown",
    [
        pytest.param([(True, 1.0, 0.003)] * 10_000, id="a constant reading at rest"),
        pytest.param([(False, 0.0, 1e-4 * period) for period in range(PERIODS)], id="no touch"),
        pytest.param(
            [
                (True, 1.0 + 1.5 * ANSWER_N * (turn % 2), 1e-3 * turn + 1e-5 * k)
                for turn in range(20)
                for k in range(45)
            ],
            id="a change of the reading restarts the watch",
        ),
        pytest.param([(True, 1.0 + 2.0 * (k % 20 == 0), 0.003) for k in range(1_000)], id="occasional jumps"),
    ],
)
def test_what_a_good_sensor_may_show_is_no_fault(shown: list[tuple[bool, float, float]]) -> None:
    watch = SensorWatch()
    assert not any(watch.check(touching, force_n, at_m, 1e-3) for touching, force_n, at_m in shown)


@pytest.mark.parametrize("jump_n", [2.0 * JUMP_N, 3.0])
def test_an_oscillating_force_is_an_open_input(jump_n: float) -> None:
    watch = SensorWatch()
    complaints = [watch.check(True, 1.0 + jump_n * (period % 2), 0.003, 1e-3) for period in range(10)]
    assert complaints[:4] == [None] * 4
    assert complaints[4] is not None
    assert "connected" in complaints[4]


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
