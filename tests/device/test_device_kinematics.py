import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.servos import Linkage, Pulses
from hapticnet.errors import SettingsError

LINKAGE = Linkage()
RETRACTED: Pulses = (LINKAGE.retracted_us,) * 3
WITHIN_TRAVEL_M = st.floats(0.0, LINKAGE.travel_m)
MOVES_M = st.lists(st.one_of(WITHIN_TRAVEL_M, st.floats(0.004, 0.0045)), min_size=1, max_size=40)


def walk(displacements_m: list[float]) -> list[tuple[Pulses, Pulses]]:
    """Return the start and the goal of each move."""
    held_us = RETRACTED
    steps = []
    for displacement_m in displacements_m:
        pulses_us = LINKAGE.pulses_us(displacement_m, held_us)
        steps.append((held_us, pulses_us))
        held_us = pulses_us
    return steps


@given(WITHIN_TRAVEL_M)
def test_pulse_and_displacement_are_inverse(displacement_m: float) -> None:
    assert LINKAGE.displacement_m(LINKAGE.pulse_us(displacement_m)) == pytest.approx(displacement_m, abs=1e-12)


def test_the_travel_follows_from_the_arms() -> None:
    swept = math.sin(math.radians(50)) + math.sin(math.radians(30))
    assert LINKAGE.travel_m == pytest.approx(0.012 * swept)


@pytest.mark.parametrize("displacement_m", [math.nan, math.inf, -math.inf, -1.0, -1e300, 0.0])
def test_an_invalid_displacement_retracts(displacement_m: float) -> None:
    assert LINKAGE.pulse_us(displacement_m) == LINKAGE.retracted_us


@pytest.mark.parametrize("displacement_m", [1.0, 1e300, LINKAGE.travel_m * 1.01])
def test_beyond_the_travel_it_is_extended(displacement_m: float) -> None:
    assert LINKAGE.pulse_us(displacement_m) == LINKAGE.extended_us


@given(MOVES_M)
def test_every_servo_stays_or_moves_by_at_least_a_deadband_in_whole_timer_steps(displacements_m: list[float]) -> None:
    for held_us, pulses_us in walk(displacements_m):
        for before_us, after_us in zip(held_us, pulses_us, strict=True):
            assert after_us == before_us or abs(after_us - before_us) >= LINKAGE.deadband_us
            assert (after_us / LINKAGE.timer_step_us).is_integer()


@given(MOVES_M)
def test_the_error_of_the_mean_pulse_is_below_a_quarter_deadband(displacements_m: list[float]) -> None:
    for displacement_m, (_, pulses_us) in zip(displacements_m, walk(displacements_m), strict=True):
        missed_us = sum(pulses_us) / 3.0 - LINKAGE.pulse_us(displacement_m)
        assert abs(missed_us) < LINKAGE.deadband_us / 4.0


@given(MOVES_M)
def test_the_servos_stay_within_two_deadbands_of_each_other_and_of_the_travel(displacements_m: list[float]) -> None:
    margin_us = 2.0 * LINKAGE.deadband_us
    for _, pulses_us in walk(displacements_m):
        assert max(pulses_us) - min(pulses_us) <= margin_us
        assert LINKAGE.retracted_us - margin_us < min(pulses_us)
        assert max(pulses_us) < LINKAGE.extended_us + margin_us


@given(MOVES_M)
def test_repeating_a_displacement_changes_nothing(displacements_m: list[float]) -> None:
    _, pulses_us = walk(displacements_m)[-1]
    assert LINKAGE.pulses_us(displacements_m[-1], pulses_us) == pulses_us


def test_a_small_motion_moves_one_servo_and_a_large_one_all_three() -> None:
    level_us = LINKAGE.level_us
    height_m = LINKAGE.displacement_m(level_us + 3.0)
    assert LINKAGE.pulses_us(height_m, (level_us,) * 3) == (level_us + 9.0, level_us, level_us)
    height_m = LINKAGE.displacement_m(level_us + 20.0)
    assert LINKAGE.pulses_us(height_m, (level_us + 9.0, level_us, level_us)) == (level_us + 20.0,) * 3


@pytest.mark.parametrize(
    "bad",
    [
        {"arm_m": math.nan},
        {"arm_m": 0.0},
        {"us_per_degree": math.inf},
        {"retracted_us": 2100.0},
        {"retracted_us": 2000.0},
        {"extended_us": 3000.0},
        {"extended_us": 2400.0},
        {"timer_step_us": 0.0},
        {"deadband_us": -1.0},
    ],
)
def test_refuses_bad_settings(bad: dict[str, float]) -> None:
    with pytest.raises(SettingsError):
        Linkage(**bad)
