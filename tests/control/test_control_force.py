"""The controller alone, against readings made up for each rule. How it does on a device is test_control_loop."""

import dataclasses
import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.force import ForceController, ForceControlSettings
from hapticnet.errors import SettingsError

SETTINGS = ForceControlSettings()
TICK_US = 1_000
ANY = st.floats(allow_nan=True, allow_infinity=True)


def spring(stiffness_n_m: float, contact_m: float = 0.002) -> Callable[[float], float]:
    """A perfect, immediate finger."""
    return lambda displacement_m: max(0.0, stiffness_n_m * (displacement_m - contact_m))


def run(
    controller: ForceController,
    target_n: float,
    sense: Callable[[float], float],
    *,
    start_us: int = 0,
    seconds: float = 3.0,
) -> list[float]:
    """Return the displacement [m] of each tick."""
    displacement_m = controller.update(target_n, 0.0, start_us)
    trace = []
    for tick in range(1, int(seconds * 1e6) // TICK_US):
        displacement_m = controller.update(target_n, sense(displacement_m), start_us + tick * TICK_US)
        trace.append(displacement_m)
    return trace


@given(st.lists(st.tuples(ANY, ANY, st.integers(-(10**6), 10**6)), max_size=100))
def test_displacement_stays_within_the_travel_for_any_input(calls: list[tuple[float, float, int]]) -> None:
    controller = ForceController(SETTINGS)
    now_us = 0
    for target_n, sensed_n, elapsed_us in calls:
        now_us += elapsed_us
        assert 0.0 <= controller.update(target_n, sensed_n, now_us) <= SETTINGS.travel_m


@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 6.0), st.integers(0, 50_000)), max_size=100))
def test_never_moves_toward_the_finger_faster_than_the_press_speed(calls: list[tuple[float, float, int]]) -> None:
    controller = ForceController(SETTINGS)
    now_us, before_m = 0, 0.0
    longest_s = 2e-6 * SETTINGS.period_us
    for target_n, sensed_n, elapsed_us in calls:
        now_us += elapsed_us
        displacement_m = controller.update(target_n, sensed_n, now_us)
        assert displacement_m - before_m <= SETTINGS.press_speed_m_s * longest_s + 1e-12
        before_m = displacement_m


@pytest.mark.parametrize("sensed_n", [math.nan, math.inf, -math.inf, 1e300, -1e300])
def test_an_absurd_reading_retracts_at_once(sensed_n: float) -> None:
    controller = ForceController(SETTINGS)
    assert run(controller, 1.0, spring(1000.0))[-1] > 0.002
    assert controller.update(1.0, sensed_n, 3_000_001) == 0.0


def test_a_target_that_is_not_finite_retracts() -> None:
    controller = ForceController(SETTINGS)
    pressed_m = run(controller, 1.0, spring(1000.0))[-1]
    assert run(controller, math.nan, spring(1000.0), start_us=3_000_000)[-1] < pressed_m - SETTINGS.clearance_m


def test_calls_within_a_control_period_return_the_last_output() -> None:
    controller = ForceController(SETTINGS)
    trace = [controller.update(1.0, 0.0, tick * TICK_US) for tick in range(100)]
    assert all(trace[tick] == trace[tick - tick % 10] for tick in range(100))
    assert len(set(trace)) == 10


def test_a_sensor_stuck_at_zero_advances_no_further_than_the_reach() -> None:
    trace = run(ForceController(SETTINGS), 5.0, lambda _: 0.0, seconds=20.0)
    assert max(trace) == trace[-1] == SETTINGS.reach_m


def test_a_sensor_that_falls_silent_while_pressing_lets_go_to_where_touch_was() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 4.0, spring(1000.0))
    trace = run(controller, 4.0, lambda _: 0.0, start_us=3_000_000, seconds=20.0)
    touch_m = 0.002 + SETTINGS.touch_n / 1000.0
    assert trace[-1] <= touch_m + SETTINGS.search_m


def test_a_sensor_stuck_at_full_scale_retracts_fully() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 4.0, spring(1000.0))
    assert run(controller, 4.0, lambda _: 20.0, start_us=3_000_000)[-1] == 0.0


def test_at_the_end_of_travel_nothing_winds_up() -> None:
    controller = ForceController(SETTINGS)
    soft = spring(250.0)
    trace = run(controller, 5.0, soft, seconds=60.0)
    assert trace[-1] == SETTINGS.travel_m
    first_period = [controller.update(0.5, soft(trace[-1]), 60_000_000 + tick * TICK_US) for tick in range(21)]
    assert first_period[-1] < SETTINGS.travel_m


def test_retracted_against_a_force_nothing_winds_up() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 1.0, lambda _: 5.0, seconds=60.0)
    assert run(controller, 1.0, lambda _: 0.5, start_us=60_000_000, seconds=0.1)[-1] > 0.0


def test_within_the_deadband_the_platform_rests() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 1.0, spring(1000.0))
    within = run(controller, 1.0, lambda _: 1.0 + 0.9 * SETTINGS.deadband_n, start_us=3_000_000, seconds=1.0)
    assert len(set(within[50:])) == 1


@pytest.mark.parametrize("target_n", [0.0, 0.05, 0.19])
def test_a_target_below_the_threshold_never_moves_toward_the_finger(target_n: float) -> None:
    assert set(run(ForceController(SETTINGS), target_n, lambda _: 0.0, seconds=10.0)) == {0.0}


def test_a_target_below_the_threshold_waits_just_off_the_point_of_touch() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 2.0, spring(1000.0))
    trace = run(controller, 0.1, spring(1000.0), start_us=3_000_000, seconds=10.0)
    assert 0.0005 < trace[-1] < 0.002
    assert len(set(trace[50:])) == 1


def test_reset_retracts_and_starts_softly() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 2.0, spring(1000.0))
    controller.reset()
    trace = run(controller, 2.0, spring(1000.0), start_us=3_000_000, seconds=0.1)
    assert trace[-1] == pytest.approx(0.1 * SETTINGS.approach_speed_m_s)


def test_a_long_gap_and_clock_jumps_make_no_leap() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 1.0, lambda _: 0.5, seconds=0.2)
    before_m = controller.update(1.0, 0.5, 10**12)
    for now_us in (2 * 10**12, 5, 5, 4, 3 * 10**12):
        displacement_m = controller.update(1.0, 0.5, now_us)
        assert abs(displacement_m - before_m) <= SETTINGS.press_speed_m_s * 2e-6 * SETTINGS.period_us
        before_m = displacement_m


def test_swings_at_the_same_target_widen_the_deadband_until_the_target_changes() -> None:
    controller = ForceController(SETTINGS)
    run(controller, 1.0, spring(1000.0))
    error_n = 1.5 * SETTINGS.deadband_n

    def swing(target_n: float, start: int) -> list[float]:
        trace = []
        for half in range(start, start + 6):
            sensed_n = target_n + (error_n if half % 2 else -error_n)
            trace += run(controller, target_n, lambda _, n=sensed_n: n, start_us=(half + 6) * 500_000, seconds=0.5)
        return trace

    hunting = swing(1.0, 0)
    assert len(set(hunting[-200:])) == 1
    assert len(set(swing(1.5, 6)[300:490])) > 5


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(ForceControlSettings)])
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_refuses_bad_settings(field: str, value: float) -> None:
    with pytest.raises(SettingsError, match="must be between"):
        ForceControlSettings(**{field: value})
