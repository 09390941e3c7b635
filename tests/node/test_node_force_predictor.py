"""The force expected ahead: which forecast is used, and how far it can be wrong. Virtual time."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.codec.registry import make_codec
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.hold import FRESH_US, HoldSettings
from hapticnet.device.servos import Servo
from hapticnet.device.simulated import Finger, PlantSettings, Sensor, SimulatedDevice
from hapticnet.hardware import SLEW_N_PER_S
from hapticnet.node.applied import AppliedForce
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.force_predictor import STIFFEST_N_M, ForcePredictor
from hapticnet.perception import WeberLaw
from hapticnet.protocol.states import ForceArrived, HoldConfirmed
from hapticnet.vectors import magnitude

TICK_US = 1_000
LEAD_US = 30_000
STIFFNESS_N_M = 400.0
SPEED_M_S = 0.02


def press(predictor: ForcePredictor, ms: int, *, late_ms: int = 0, step_n: float = 0.1) -> tuple[float, float]:
    """Push into a spring at a steady speed with an update each `step_n`; return the force now and the one expected."""
    held_n, expected_n = 0.0, 0.0
    for tick in range(ms):
        now_us = tick * TICK_US
        predictor.move(now_us, (SPEED_M_S * 1e-6 * now_us,))
        at_us = now_us - 1_000 * late_ms
        true_n = STIFFNESS_N_M * SPEED_M_S * 1e-6 * max(at_us, 0)
        if abs(true_n - held_n) >= step_n:
            held_n = true_n
            predictor.learn(at_us, (true_n,))
        (expected_n,) = predictor.expected(now_us, at_us, LEAD_US, (held_n,), lambda _lead, _at, n=held_n: (n,))
    return held_n, expected_n


@pytest.mark.parametrize("late_ms", [0, 20, 100])
def test_held_updates_of_a_spring_tell_its_stiffness_and_with_the_hands_speed_the_force_ahead(late_ms: int) -> None:
    predictor = ForcePredictor(1)
    force_n, expected_n = press(predictor, 500, late_ms=late_ms)
    assert predictor.gradient_n_m[0][0] == pytest.approx(STIFFNESS_N_M, rel=0.05)
    assert expected_n - force_n == pytest.approx(STIFFNESS_N_M * SPEED_M_S * 1e-6 * LEAD_US, rel=0.1)


def test_a_breach_leaves_nothing_of_the_stiffness() -> None:
    predictor = ForcePredictor(1)
    press(predictor, 500)
    now_us = 500 * TICK_US
    predictor.move(now_us, (0.01,))
    predictor.learn(now_us, (0.0,))
    assert predictor.gradient_n_m == ((0.0,),)
    assert predictor.expected(now_us, now_us, LEAD_US, (0.0,), None) == (0.0,)


def test_a_decoder_that_foretells_best_is_believed() -> None:
    predictor = ForcePredictor(1)
    for tick in range(500):  # a force that swings in time, at a hand that stands still
        now_us = tick * TICK_US

        def swing_n(t_us: int) -> float:
            return 2.0 + math.sin(2e-6 * math.pi * t_us)

        predictor.move(now_us, (0.0,))
        predictor.learn(now_us, (swing_n(now_us),))
        expected = predictor.expected(
            now_us, now_us, LEAD_US, (swing_n(now_us),), lambda lead_us, _, n=now_us: (swing_n(n + lead_us),)
        )
    assert expected == (swing_n(now_us + LEAD_US),)


def test_a_forecast_that_errs_is_not_used() -> None:
    predictor = ForcePredictor(1)
    for tick in range(500):
        now_us = tick * TICK_US
        predictor.move(now_us, (1e-3 * math.sin(tick),))  # the force does not care where the hand is
        force_n = (1.0 + 0.1 * math.sin(0.7 * tick),)
        predictor.learn(now_us, force_n)
        expected = predictor.expected(now_us, now_us, LEAD_US, force_n, lambda _lead, _at: (4.0,))
    hold, codec, stiffness = predictor.errors_n2
    assert hold < codec
    assert hold < stiffness
    assert expected == force_n


FORCE = st.floats(-1000.0, 1000.0)
POSITION = st.floats(-10.0, 10.0)


@given(st.integers(1, 3), st.data())
def test_whatever_arrives_the_forecast_is_finite_and_the_stiffness_bounded(axes: int, data: st.DataObject) -> None:
    predictor = ForcePredictor(axes)
    now_us = 0
    for _ in range(data.draw(st.integers(1, 20))):
        now_us += data.draw(st.integers(-5_000, 50_000))
        position_m = tuple(data.draw(st.tuples(*[POSITION] * axes)))
        force_n = tuple(data.draw(st.tuples(*[FORCE] * axes)))
        predictor.move(now_us, position_m)
        predictor.learn(now_us - data.draw(st.integers(0, 100_000)), force_n)
        ahead_n = predictor.expected(now_us, now_us, LEAD_US, force_n, None)
        assert len(ahead_n) == axes
        assert all(map(math.isfinite, ahead_n))
        assert all(magnitude(row) <= STIFFEST_N_M * (1.0 + 1e-9) for row in predictor.gradient_n_m)


def rising(codec_name: str) -> tuple[AppliedForce, int]:
    """Return a master that pushes into a spring, over a link that has just gone silent, and the time."""
    codec = make_codec(codec_name, WeberLaw(), {})
    applied = AppliedForce(codec, HoldSettings(), 1)
    applied.begin(codec)
    encoder = codec.encoder(1)
    for tick in range(1, 501):
        now_us = tick * TICK_US
        position_m = (SPEED_M_S * 1e-6 * now_us,)
        payload = encoder.encode(now_us, (STIFFNESS_N_M * position_m[0],), position_m)
        applied.advance(now_us, TICK_US, position_m)
        if payload is not None:
            applied.receive(ForceArrived(t_us=now_us, payload=payload, sequence=tick), now_us)
        else:
            applied.confirm(HoldConfirmed(t_us=now_us), now_us)
        applied.value(now_us)
        applied.expected(now_us, LEAD_US)
    return applied, now_us


@pytest.mark.parametrize("codec", ["raw", "deadband", "linear-predictive", "adaptive-predictive", "motion-predictive"])
def test_a_link_that_falls_silent_gives_no_lead_once_it_is_not_fresh(codec: str) -> None:
    applied, now_us = rising(codec)
    led = 0
    for ms in range(1, 400):
        at_us = now_us + ms * TICK_US
        applied.advance(at_us, TICK_US, (SPEED_M_S * 1e-6 * at_us,))
        (held_n,) = applied.value(at_us)
        (ahead_n,) = applied.expected(at_us, LEAD_US)
        if ms * TICK_US > FRESH_US:
            assert ahead_n == held_n
        led += ahead_n > held_n + 0.05
    assert held_n == 0.0
    assert led > 0  # while it was fresh


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
    fingertip = Fingertip(device, ForceControlSettings())
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
