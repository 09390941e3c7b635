"""The force expected ahead: which forecast is used, and how far it can be wrong. Virtual time."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.registry import make_codec
from hapticnet.control.hold import FRESH_US, HoldSettings
from hapticnet.node.applied import AppliedForce
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


@pytest.mark.parametrize("codec", ["raw", "deadband", "linear-predictive", "adaptive-predictive", "motion-predictive"])
def test_every_codec_gives_a_lead_in_a_spring(codec: str) -> None:
    applied, now_us = rising(codec)
    (held_n,), (ahead_n,) = applied.value(now_us), applied.expected(now_us, LEAD_US)
    assert ahead_n - held_n == pytest.approx(STIFFNESS_N_M * SPEED_M_S * 1e-6 * LEAD_US, rel=0.35)
