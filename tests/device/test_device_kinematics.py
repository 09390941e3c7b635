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
def test_an_invalid_displacement_retracts_and_one_beyond_the_travel_extends(displacement_m: float) -> None:
    assert LINKAGE.pulse_us(displacement_m) == LINKAGE.retracted_us
    assert LINKAGE.pulse_us(LINKAGE.travel_m * 1.01) == LINKAGE.pulse_us(1e300) == LINKAGE.extended_us


@given(MOVES_M)
def test_pulses_are_whole_steps_of_a_deadband_near_the_goal_and_each_other(
    displacements_m: list[float],
) -> None:
    deadband_us = LINKAGE.deadband_us
    for displacement_m, (held_us, pulses_us) in zip(displacements_m, walk(displacements_m), strict=True):
        for before_us, after_us in zip(held_us, pulses_us, strict=True):
            assert after_us == before_us or abs(after_us - before_us) >= deadband_us
            assert (after_us / LINKAGE.timer_step_us).is_integer()
        assert abs(sum(pulses_us) / 3.0 - LINKAGE.pulse_us(displacement_m)) < deadband_us / 4.0
        assert max(pulses_us) - min(pulses_us) <= 2.0 * deadband_us
        assert LINKAGE.retracted_us - 2.0 * deadband_us < min(pulses_us)
        assert max(pulses_us) < LINKAGE.extended_us + 2.0 * deadband_us
        assert LINKAGE.pulses_us(displacement_m, pulses_us) == pulses_us


def test_a_small_motion_moves_one_servo_and_a_large_one_all_three() -> None:
    level_us = LINKAGE.level_us
    height_m = LINKAGE.displacement_m(level_us + 3.0)
    assert LINKAGE.pulses_us(height_m, (level_us,) * 3) == (level_us + 9.0, level_us, level_us)
    height_m = LINKAGE.displacement_m(level_us + 20.0)
    assert LINKAGE.pulses_us(height_m, (level_us + 9.0, level_us, level_us)) == (level_us + 20.0,) * 3


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("arm_m", math.nan), ("arm_m", 0.0), ("us_per_degree", math.inf), ("retracted_us", 2100.0),
        ("retracted_us", 2000.0), ("extended_us", 3000.0), ("extended_us", 2400.0), ("timer_step_us", 0.0),
        ("deadband_us", -1.0),
    ],
)  # fmt: skip
def test_refuses_bad_settings(name: str, value: float) -> None:
    with pytest.raises(SettingsError):
        Linkage(**{name: value})
