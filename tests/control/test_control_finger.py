"""The model of the finger learned from positions of the platform and readings."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.finger import FingerSettings, LearnedFinger, compressed
from hapticnet.errors import SettingsError
from hapticnet.hardware import SOFTEST_N_M, STIFFENING, STIFFEST_N_M

PERIOD_S = 0.01


def press(finger: LearnedFinger, stiffness_n_m: float, forces_n: list[float], contact_m: float = 0.002) -> None:
    """Learn from exact readings of a finger, with the platform at rest."""
    for force_n in forces_n:
        displacement_m = contact_m + compressed(force_n) / stiffness_n_m
        if not finger.felt:
            finger.touch(displacement_m, force_n)
        finger.learn(displacement_m, force_n, 0.0, PERIOD_S)


@given(st.floats(0.01, 20.0))
def test_the_curve_is_the_inverse_of_the_fingertip_law(force_n: float) -> None:
    compression = compressed(force_n)
    k0, b = 1.0 - STIFFENING, STIFFENING
    assert k0 / b * math.expm1(b * compression) == pytest.approx(force_n)


@pytest.mark.parametrize("stiffness_n_m", [300.0, 600.0, 1000.0, 2000.0, 3000.0])
def test_stiffness_and_position_are_learned_from_a_few_forces(stiffness_n_m: float) -> None:
    finger = LearnedFinger(FingerSettings())
    press(finger, stiffness_n_m, [0.3, 0.5, 1.0, 1.5, 2.0] * 4)
    assert 1.0 / finger.compliance_m_n == pytest.approx(stiffness_n_m, rel=0.05)
    assert finger.contact_m == pytest.approx(0.002, abs=5e-5)
    assert finger.displacement_m(1.0) == pytest.approx(0.002 + compressed(1.0) / stiffness_n_m, abs=2e-5)


def test_a_finger_held_at_rest_is_not_forgotten() -> None:
    finger = LearnedFinger(FingerSettings())
    press(finger, 3000.0, [0.3, 0.5, 1.0, 2.0] * 5)
    press(finger, 3000.0, [2.0] * 60_000)
    assert 1.0 / finger.compliance_m_n == pytest.approx(3000.0, rel=0.05)
    assert finger.cautious_m_n >= 0.6 * finger.compliance_m_n


def test_a_finger_that_moves_is_followed_and_its_stiffness_found_again() -> None:
    finger = LearnedFinger(FingerSettings())
    press(finger, 1000.0, [0.3, 0.5, 1.0, 2.0] * 5)
    for tick in range(300):
        press(finger, 1000.0, [1.5], contact_m=0.002 + 1e-5 * tick)
    assert finger.displacement_m(1.5) == pytest.approx(0.005 + compressed(1.5) / 1000.0, abs=1e-4)
    press(finger, 1000.0, [0.5, 1.0, 2.0] * 10, contact_m=0.005)
    assert 1.0 / finger.compliance_m_n == pytest.approx(1000.0, rel=0.1)


def test_learning_is_slow_while_the_platform_moves() -> None:
    moving, resting = LearnedFinger(FingerSettings()), LearnedFinger(FingerSettings())
    for finger, speed_m_s in ((moving, 0.06), (resting, 0.0)):
        press(finger, 1000.0, [0.3, 0.5, 1.0] * 5)
        finger.learn(0.006, 1.0, speed_m_s, PERIOD_S)
    assert moving.displacement_m(1.0) - 0.003 < 0.2 * (resting.displacement_m(1.0) - 0.003)


def test_a_finger_touched_again_may_have_moved() -> None:
    finger = LearnedFinger(FingerSettings())
    press(finger, 1000.0, [0.3, 0.5, 1.0, 2.0] * 5)
    known = finger.gain_at(1.0, PERIOD_S)
    finger.touch(0.003, 0.3)
    assert finger.gain_at(1.0, PERIOD_S) > known


@given(st.lists(st.tuples(st.floats(-0.1, 0.1), st.floats(0.0, 1e3), st.floats(-10.0, 10.0)), max_size=200))
def test_the_estimate_stays_a_finger_for_any_input(shown: list[tuple[float, float, float]]) -> None:
    finger = LearnedFinger(FingerSettings())
    finger.touch(0.002, 0.2)
    for displacement_m, force_n, speed_m_s in shown:
        finger.learn(displacement_m, force_n, speed_m_s, PERIOD_S)
        assert 1.0 / STIFFEST_N_M <= finger.compliance_m_n <= 1.0 / SOFTEST_N_M
        assert 1.0 / STIFFEST_N_M <= finger.cautious_m_n <= finger.compliance_m_n * (1.0 + 1e-12)
        assert math.isfinite(finger.contact_m)
        assert 0.0 <= finger.gain_at(1.0, PERIOD_S) <= 1.0


def test_forgetting_restores_the_prior() -> None:
    finger = LearnedFinger(FingerSettings())
    press(finger, 3000.0, [0.3, 0.5, 1.0])
    finger.forget()
    fresh = LearnedFinger(FingerSettings())
    assert (finger.felt, finger.compliance_m_n, finger.gain_at(1.0, PERIOD_S)) == (
        fresh.felt,
        fresh.compliance_m_n,
        fresh.gain_at(1.0, PERIOD_S),
    )


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(FingerSettings)])
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_refuses_bad_settings(field: str, value: float) -> None:
    with pytest.raises(SettingsError, match="must be between"):
        FingerSettings(**{field: value})
