"""A fingertip that is told the force expected ahead, on fingers and servos of all kinds, in virtual time."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import SLEW_N_PER_S, LimitSettings
from hapticnet.device.servos import Servo
from hapticnet.device.simulated import Finger, PlantSettings, Sensor, SimulatedDevice
from hapticnet.node.fingertip import Fingertip

LEAD_MS = round(1e3 * ForceControlSettings().foresight_s)

PLANTS = st.builds(
    lambda stiffness_n_m, stiffening, contact_m, backlash_deg, lag_s, hysteresis: PlantSettings(
        finger=Finger(stiffness_n_m=stiffness_n_m, stiffening=stiffening, contact_m=contact_m),
        servo=Servo(backlash_deg=backlash_deg, lag_s=lag_s),
        sensor=Sensor(hysteresis=hysteresis),
    ),
    st.floats(300.0, 3000.0),
    st.floats(0.0, 0.5),
    st.floats(0.0015, 0.0025),
    st.floats(0.0, 1.0),
    st.floats(0.02, 0.04),
    st.floats(0.0, 0.15),
)
"""Soft and stiff fingers, springs and others that stiffen, tight gears and worn ones, servos faster and slower than
believed."""


def felt_n(
    plant: PlantSettings,
    milliseconds: int,
    force_n: Callable[[int], float],
    ahead_n: Callable[[int], float | None],
    *,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return target and true force [N] of each ms, after the finger was found and released."""
    device = SimulatedDevice(plant, np.random.default_rng(seed))
    fingertip = Fingertip(device, LimitSettings(), ForceControlSettings())
    for ms in range(2_500):
        fingertip.press(1.0 if 200 <= ms < 2_000 else 0.0, ms * 1_000)
    rows = []
    for ms in range(milliseconds):
        fingertip.press(force_n(ms), (2_500 + ms) * 1_000, ahead_n(ms))
        rows.append((fingertip.target_n, device.contact_force_n))
    target_n, true_n = np.array(rows).T
    return target_n, true_n


@given(PLANTS, st.floats(1.0, 4.6), st.floats(2.0, 40.0))
@settings(max_examples=25, deadline=None)
def test_a_rise_that_is_foretold_overshoots_by_no_more_than_5_percent_and_a_step_of_the_servos(
    plant: PlantSettings, top_n: float, rise_n_per_s: float
) -> None:
    def rise(ms: int) -> float:
        return min(top_n, 1e-3 * rise_n_per_s * max(ms - 100, 0))

    _, true_n = felt_n(plant, 1_500, rise, lambda ms: rise(ms + LEAD_MS))
    stiffness_n_m = plant.finger.stiffness_n_m * (1.0 - plant.finger.stiffening * (1.0 - top_n))
    servo_step_n = 0.53 * 0.056e-3 * stiffness_n_m
    assert true_n.max() <= 1.05 * top_n + servo_step_n


@given(PLANTS, st.floats(0.1, 4.6), st.floats(-50.0, 50.0) | st.sampled_from([math.nan, math.inf, -math.inf]))
@settings(max_examples=25, deadline=None)
def test_a_rise_that_is_foretold_and_never_comes_is_bounded_by_what_the_limits_allow_in_that_time(
    plant: PlantSettings, force_n: float, ahead_n: float
) -> None:
    _, true_n = felt_n(plant, 1_000, lambda _: force_n, lambda ms: ahead_n if ms > 500 else None)
    largest_n = min(force_n + SLEW_N_PER_S * 1e-3 * LEAD_MS, 4.6)
    assert true_n.max() <= 1.05 * largest_n + 0.3
    assert true_n.max() <= 5.0


@pytest.mark.parametrize("force_n", [0.0, -1.0])
def test_a_contact_that_is_foretold_in_free_space_is_touched_no_harder_than_the_limits_allow(force_n: float) -> None:
    _, true_n = felt_n(PlantSettings(), 500, lambda _: force_n, lambda _: 4.0)
    assert true_n.max() <= SLEW_N_PER_S * 1e-3 * LEAD_MS + 0.2


@pytest.mark.parametrize("force_n", [math.nan, math.inf])
def test_beside_a_force_that_is_not_finite_nothing_is_foretold(force_n: float) -> None:
    _, true_n = felt_n(PlantSettings(), 500, lambda ms: 2.0 if ms < 200 else force_n, lambda _: 4.0)
    assert true_n[400:].max() == 0.0


def test_no_forecast_presses_harder_than_the_clamp() -> None:
    target_n, true_n = felt_n(PlantSettings(finger=Finger(stiffness_n_m=3000.0)), 3_000, lambda _: 50.0, lambda _: 99.0)
    assert target_n.max() <= 4.6
    assert true_n.max() <= 5.0


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_breach_that_is_foretold_is_felt_earlier(stiffness_n_m: float, seed: int) -> None:
    plant = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))

    def breach(ms: int) -> float:
        return 0.005 * ms if ms < 600 + 7 * seed else 0.0

    def error_n(lead_ms: int) -> float:
        target_n, true_n = felt_n(plant, 900, breach, lambda ms: breach(ms + lead_ms), seed=seed)
        return float(np.sqrt(np.mean((true_n - target_n)[500:] ** 2)))

    assert error_n(LEAD_MS) <= 0.8 * error_n(0)
