import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.servos import Linkage, Pulses, Servo, Servos

LINKAGE = Linkage()
IDEAL = Servo(backlash_deg=0.0)
LAG_S = Servo().lag_s

pulses = st.floats(1200.0, 2000.0)


def settled_at(pulses_us: Pulses, servo: Servo = IDEAL) -> Servos:
    made = Servos(LINKAGE, servo)
    made.take(pulses_us)
    made.move(5_000_000)
    return made


def test_a_small_motion_is_a_first_order_lag() -> None:
    made = Servos(LINKAGE, IDEAL)
    made.take((1260.0,) * 3)
    after_us = 0
    for step_us in (10_000, 9_000, 26_000, 55_000):
        after_us += step_us
        made.move(step_us)
        pulse_us = LINKAGE.pulse_us(made.displacement_m)
        assert pulse_us == pytest.approx(1260.0 - 60.0 * math.exp(-after_us * 1e-6 / LAG_S), abs=0.02)


def test_a_large_motion_runs_at_the_speed_limit() -> None:
    made = Servos(LINKAGE, IDEAL)
    made.take((2000.0,) * 3)
    made.move(100_000)
    assert LINKAGE.pulse_us(made.displacement_m) == pytest.approx(1200.0 + 353.0 * 10.0 * 0.1)


@given(st.tuples(pulses, pulses, pulses), st.lists(st.floats(1.0, 150_000.0), min_size=1, max_size=60))
def test_the_motion_does_not_depend_on_the_steps(goal_us: Pulses, steps_us: list[float]) -> None:
    in_steps, at_once = Servos(LINKAGE, Servo()), Servos(LINKAGE, Servo())
    for made in (in_steps, at_once):
        made.take(goal_us)
    for step_us in steps_us:
        in_steps.move(step_us)
    at_once.move(math.fsum(steps_us))
    assert in_steps.displacement_m == pytest.approx(at_once.displacement_m, abs=2e-6)


@given(st.lists(st.tuples(pulses, st.integers(0, 2), st.floats(-1e6, 1e15)), max_size=40))
def test_the_platform_stays_within_the_range_of_its_pulses(calls: list[tuple[float, int, float]]) -> None:
    made = Servos(LINKAGE, Servo())
    highest_us = LINKAGE.retracted_us
    for pulse_us, index, elapsed_us in calls:
        made.take_one(index, pulse_us)
        made.move(elapsed_us)
        highest_us = max(highest_us, pulse_us)
        assert -1e-12 <= made.displacement_m <= LINKAGE.displacement_m(highest_us) + 1e-12


def test_repeated_and_earlier_times_move_nothing() -> None:
    made = Servos(LINKAGE, IDEAL)
    assert made.taken_us == (LINKAGE.retracted_us,) * 3
    assert not made.move(1_000_000)
    made.take((1500.0,) * 3)
    assert not made.move(0)
    assert not made.move(-1_000_000)
    assert made.displacement_m == 0.0
    assert made.move(10_000)
    made.take((1504.0,) * 3)  # within a deadband of the goal, but not of the position
    made.move(5_000_000)
    assert LINKAGE.pulse_us(made.displacement_m) == pytest.approx(1504.0)


def test_a_servo_ignores_less_than_its_deadband() -> None:
    made = settled_at((1500.0,) * 3)
    before_m = made.displacement_m
    made.take((1507.9, 1492.1, 1507.9))
    assert not made.move(1_000_000)
    assert made.taken_us == (1507.9, 1492.1, 1507.9)
    made.take((1508.1, 1492.1, 1507.9))
    made.move(1_000_000)
    assert made.displacement_m == pytest.approx(before_m + 0.012 * math.radians(0.81) / 3, rel=0.01)


def test_a_pulse_for_one_servo_moves_only_that_one() -> None:
    made = settled_at((1500.0,) * 3)
    before_m = made.displacement_m
    made.take_one(1, 1560.0)
    assert made.taken_us == (1500.0, 1560.0, 1500.0)
    made.move(5_000_000)
    assert made.displacement_m - before_m == pytest.approx(LINKAGE.arm_m * math.sin(math.radians(6.0)) / 3.0)


def test_backlash_lags_behind_on_reversal() -> None:
    servo = Servo(backlash_deg=2.0)
    made = settled_at((1500.0,) * 3, servo)
    assert LINKAGE.pulse_us(made.displacement_m) == pytest.approx(1490.0)
    made.take((1481.0,) * 3)
    made.move(5_000_000)
    assert LINKAGE.pulse_us(made.displacement_m) == pytest.approx(1490.0)
    made.take((1450.0,) * 3)
    made.move(5_000_000)
    assert LINKAGE.pulse_us(made.displacement_m) == pytest.approx(1460.0)
