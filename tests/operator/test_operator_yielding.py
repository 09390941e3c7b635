"""The mechanics of a hand that yields, and of the device that it holds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hapticnet.errors import SettingsError
from hapticnet.operator.yielding import HANDS, LONGEST_STEP_US, GroundedSettings, HandSettings, YieldingOperator
from hapticnet.oscillator import exact_step
from hapticnet.samples import PositionSample

ARM = HANDS["arm"]


class Still:
    """Intends to stay at one place, or to move at one speed."""

    duration_us = None

    def __init__(self, *position_m, speed=0.0):
        self.axes, self.position_m, self.speed = len(position_m), position_m, speed

    def sample(self, t_us):
        return PositionSample(t_us, tuple(at + 1e-6 * self.speed * t_us for at in self.position_m))


def moved(hand, force_n, seconds, *, device=None, period_us=1000, intended=None):
    """Return the positions of a hand under a constant force, or a function of time, position [m] and tick."""
    made = YieldingOperator(intended or Still(0.0), hand, device)
    places = [made.sample(0).position_m[0]]
    for tick in range(1, round(1e6 * seconds / period_us) + 1):
        made.feel(tick * period_us, (force_n(places[-1]) if callable(force_n) else force_n,))
        places.append(made.sample(tick * period_us).position_m[0])
    return np.array(places)


@pytest.mark.parametrize("damping", [0.0, 6.45, 2.0 * math.sqrt(0.554 * 135.0), 100.0, 1e4])
def test_two_half_steps_are_a_whole_one(damping):
    half, whole = (np.array(exact_step(0.554, damping, 135.0, step_s)) for step_s in (0.5e-3, 1e-3))
    matrix, pushed = half[[0, 1, 3, 4]].reshape(2, 2), half[[2, 5]]
    assert (matrix @ matrix).ravel() == pytest.approx(whole[[0, 1, 3, 4]], rel=1e-9)
    assert matrix @ pushed + pushed == pytest.approx(whole[[2, 5]], rel=1e-9)


@pytest.mark.parametrize("step_s", [1e-4, 1e-3, 0.02])
def test_an_undamped_hand_keeps_its_energy(step_s):
    xx, xv, _, vx, vv, _ = exact_step(0.5, 0.0, 200.0, step_s)
    x, v = 0.01, 0.0
    for _ in range(100_000):
        x, v = xx * x + xv * v, vx * x + vv * v
    assert 0.25 * v * v + 100.0 * x * x == pytest.approx(0.01, rel=1e-9)


def test_a_damped_hand_follows_the_textbook():
    middle, natural = 6.45 / (2.0 * 0.554), math.sqrt(135.0 / 0.554)
    t_s, turn = np.arange(0, 1001) * 1e-3, math.sqrt(natural**2 - middle**2)
    swing = np.exp(-middle * t_s) * (np.cos(turn * t_s) + middle / turn * np.sin(turn * t_s))
    assert moved(ARM, 1.0, 1.0) == pytest.approx((swing - 1.0) / 135.0, abs=1e-12)


@pytest.mark.parametrize("mass", [1e-6, 1e-3, 100.0])
@pytest.mark.parametrize("damping", [0.0, 1e-3, 1e4])
@pytest.mark.parametrize("stiffness", [1.0, 1e6])
@pytest.mark.parametrize("period_us", [100, 1000, 50_000])
def test_no_mass_stiffness_or_rate_breaks_the_hand(mass, damping, stiffness, period_us):
    hand = HandSettings(mass_kg=mass, damping_n_s_per_m=damping, stiffness_n_per_m=stiffness)
    places = moved(hand, 1.0, 200 * 1e-6 * period_us, period_us=period_us)
    assert np.isfinite(places).all()
    assert np.abs(places).max() <= 2.001 / stiffness  # as far as a step of force throws an undamped mass
    assert places.max() <= 1e-3 / stiffness


def test_a_force_that_stays_moves_the_hand_by_force_over_stiffness_against_the_tissue():
    assert moved(ARM, 1.35, 5.0)[-1] == pytest.approx(-0.01, rel=1e-6)
    with_device = moved(ARM, 1.35, 5.0, device=GroundedSettings(mass_kg=0.5, damping_n_s_per_m=3.0))
    assert with_device[-1] == pytest.approx(-0.01, rel=1e-4)


def test_friction_holds_a_force_below_it_and_takes_as_much_of_a_larger_one():
    device = GroundedSettings(friction_n=0.5)
    assert np.ptp(moved(ARM, 0.49, 1.0, device=device)) < 1e-12
    assert moved(ARM, 1.85, 5.0, device=device)[-1] == pytest.approx(-0.01, abs=0.0038)  # sticks 0.5 N / K around it
    drawn = moved(ARM, 0.0, 2.0, device=device, intended=Still(0.0, speed=0.02))
    assert drawn[-1] == pytest.approx(0.04 - 0.5 / 135.0, abs=1e-4)  # a hand in motion drags behind


def test_the_device_tells_places_in_steps_of_its_sensor_and_the_hand_does_not_move_in_them():
    fine, coarse = moved(ARM, 1.0, 0.5), moved(ARM, 1.0, 0.5, device=GroundedSettings(resolution_m=1e-4))
    assert coarse == pytest.approx(1e-4 * np.round(fine / 1e-4), abs=1e-9)


def test_the_device_pushes_with_its_largest_force_in_the_same_direction():
    made = YieldingOperator(Still(0.0, 0.0), ARM, GroundedSettings(max_force_n=2.0))
    made.feel(0, (3.0, -4.0))
    assert made.applied_n == pytest.approx((1.2, -1.6))
    made.feel(1000, (1.0, 0.5))
    assert made.applied_n == (1.0, 0.5)


def test_a_slow_device_takes_a_force_at_its_own_rate():
    made = YieldingOperator(Still(0.0), ARM, GroundedSettings(rate_hz=250.0))
    taken = []
    for t_us in range(0, 20_000, 1000):
        made.feel(t_us, (float(t_us),))
        taken.append(made.applied_n[0])
    assert taken == [4000.0 * (t // 4) for t in range(20)]
    made.feel(5_000, (7.0,))  # a clock that went back
    assert made.applied_n == (7.0,)


def test_after_a_pause_the_hand_goes_on_from_where_it_was():
    made = YieldingOperator(Still(0.0), replace(ARM, damping_n_s_per_m=0.0))
    made.feel(0, (1.0,))
    made.sample(0)
    before = made.sample(LONGEST_STEP_US).position_m[0]
    later = made.sample(10_000_000).position_m[0]
    assert later == pytest.approx(exact_position(2 * LONGEST_STEP_US), rel=1e-9)
    assert made.sample(10_000_000).position_m[0] == later  # no time has passed
    assert made.sample(9_000_000).position_m[0] == later  # nor does it go back
    assert before == pytest.approx(exact_position(LONGEST_STEP_US), rel=1e-9)


def exact_position(t_us):
    return -1.0 / 135.0 * (1.0 - math.cos(math.sqrt(135.0 / 0.554) * 1e-6 * t_us))


def test_a_reflex_pulls_back_as_late_as_it_is():
    quick, none = (replace(ARM, reflex_n_per_m=reflex, reflex_delay_s=0.05) for reflex in (100.0, 0.0))
    with_reflex, without = moved(quick, 1.0, 2.0), moved(none, 1.0, 2.0)
    assert with_reflex[:51] == pytest.approx(without[:51], abs=0.0)
    assert abs(with_reflex[-1]) < 0.7 * abs(without[-1])


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (HandSettings, {"mass_kg": 0.0}, "mass of the hand is 0"),
        (HandSettings, {"stiffness_n_per_m": 0.5}, "stiffness of the hand is 0.5"),
        (HandSettings, {"reflex_delay_s": 0.0}, "delay of the reflex is 0"),
        (GroundedSettings, {"max_force_n": math.nan}, "largest force of the device is nan"),
        (GroundedSettings, {"rate_hz": 10.0}, "rate of the device is 10"),
        (GroundedSettings, {"resolution_m": 1.0}, "resolution of the device is 1"),
    ],
)
def test_a_value_out_of_range_is_refused(kind, values, message):
    known = {"mass_kg": 1.0, "damping_n_s_per_m": 1.0, "stiffness_n_per_m": 100.0} if kind is HandSettings else {}
    with pytest.raises(SettingsError, match=message):
        kind(**known | values)
