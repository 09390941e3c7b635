import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import SettingsError
from hapticnet.operator.scripted import (
    TREMOR_BAND_HZ,
    InsertionSettings,
    PalpatingOperator,
    PalpationSettings,
    ScriptedOperator,
    scripted_hand,
)
from hapticnet.scene.sources import find_scene, make_scene

STEADY = {"variation": 0.0, "tremor_rms_m": 0.0}
# The paper's scene: positions of its three tissues, and of their breaches.
SURFACES_M = (0.020, 0.040, 0.060)
BREACHES_M = (0.030, 0.050, 0.070)


def make(seed=1, **settings):
    return ScriptedOperator(InsertionSettings(**settings), np.random.default_rng(seed))


def positions_m(operator, period_us=1000, until_us=None):
    return np.array(
        [operator.sample(t_us).position_m[0] for t_us in range(0, until_us or operator.duration_us, period_us)]
    )


def test_the_default_script_pierces_the_papers_tissues_and_returns_each_time():
    path_m = positions_m(make(insertions=5))
    for breach_m in BREACHES_M:
        assert np.count_nonzero((path_m[:-1] <= breach_m) & (path_m[1:] > breach_m)) == 5
    for surface_m in SURFACES_M:
        assert np.count_nonzero((path_m[:-1] >= surface_m) & (path_m[1:] < surface_m)) == 5
    assert path_m.max() == pytest.approx(0.074, abs=0.0003)
    assert path_m.min() == pytest.approx(0.0, abs=0.0003)


def test_it_pauses_after_every_step_pressing_on_two_of_the_tissues():
    path_m = positions_m(make(**STEADY, insertions=1), period_us=10_000)
    still_m = {round(float(now), 6) for before, now in itertools.pairwise(path_m) if before == now}
    assert still_m == {0.029, 0.044, 0.059, 0.074, 0.0}


def test_a_movement_is_minimum_jerk():
    operator = make(**STEADY, insertions=1, start_m=0.01, approach_m=0.03, approach_s=1.0, rest_s=0.0)
    times_us = range(0, 1_000_001, 1000)
    path_m = np.array([operator.sample(t_us).position_m[0] for t_us in times_us])
    tau = np.array(times_us) * 1e-6
    np.testing.assert_allclose(path_m, 0.01 + 0.02 * (10 * tau**3 - 15 * tau**4 + 6 * tau**5), rtol=0, atol=1e-15)
    speed = np.gradient(path_m, 1e-3)
    # The peak speed of a minimum-jerk movement is 15/8 of its mean, at half time.
    assert speed.max() == pytest.approx(1.875 * 0.02, rel=1e-4)
    assert speed.argmax() == 500
    assert speed[0] == pytest.approx(0.0, abs=1e-6)


@given(seed=st.integers(0, 2**32), t_us=st.integers(0, 16_000_000))
def test_the_motion_is_continuous(seed, t_us):
    operator = make(seed, insertions=5)
    if t_us + 100 < operator.duration_us:
        step_m = operator.sample(t_us + 100).position_m[0] - operator.sample(t_us).position_m[0]
        # The fastest movement is the withdrawal, at 1.875 · 74 mm / 0.7 s, up to 1.1 times that, plus tremor.
        assert abs(step_m) < (1.1 * 1.875 * 0.074 / 0.7 + 0.02) * 100e-6


@given(seed=st.integers(0, 2**32), times_us=st.permutations(range(0, 7_000_000, 777_777)))
def test_a_sample_depends_on_its_time_alone(seed, times_us):
    operator, other = make(seed, insertions=2), make(seed, insertions=2)
    in_this_order = {t_us: operator.sample(t_us) for t_us in times_us}
    assert in_this_order == {t_us: other.sample(t_us) for t_us in sorted(times_us)}
    assert in_this_order == {t_us: operator.sample(t_us) for t_us in times_us}


def test_a_longer_script_begins_as_a_shorter_one():
    short, long = make(insertions=2), make(insertions=5)
    assert positions_m(short).tolist() == positions_m(long, until_us=short.duration_us).tolist()


@pytest.mark.parametrize("t_us", [-1, -(2**63), "end", 2**63])
def test_outside_the_script_the_hand_rests_at_the_start(t_us):
    operator = make(start_m=0.001)
    at_us = operator.duration_us if t_us == "end" else t_us
    assert operator.sample(at_us) == (at_us, (0.001,))


def test_without_variation_all_insertions_are_the_same():
    operator = make(**STEADY, insertions=3)
    assert operator.duration_us == 3 * 5_200_000
    assert make(insertions=200).duration_us == pytest.approx(200 * 5_200_000, rel=0.02)
    for t_us in range(0, 5_200_000, 1733):
        first = operator.sample(t_us).position_m[0]
        assert operator.sample(t_us + 10_400_000).position_m[0] == pytest.approx(first, abs=1e-12)


def test_insertions_vary_in_speed_and_pauses_within_their_bounds():
    seconds = [make(seed, insertions=1, variation=0.2).duration_us * 1e-6 for seed in range(200)]
    assert min(seconds) >= 4.0 / 1.2 + 1.2 * 0.8
    assert max(seconds) <= 4.0 / 0.8 + 1.2 * 1.2
    assert np.std(seconds) > 0.2


def test_one_speed_holds_for_all_movements_of_an_insertion():
    for seed in range(20):
        operator = make(seed, insertions=1, variation=0.5, pause_s=0.0, rest_s=0.0, tremor_rms_m=0.0)
        deepest_us = round(operator.duration_us * (0.5 + 2.8) / (0.5 + 2.8 + 0.7))
        assert operator.sample(deepest_us).position_m[0] == pytest.approx(0.074, abs=1e-9)


def test_tremor_has_its_rms_and_stays_in_its_band():
    rms_m = 80e-6
    trembling = make(insertions=40, tremor_rms_m=rms_m)
    steady = make(insertions=40, tremor_rms_m=0.0)
    tremor_m = positions_m(trembling, 2000, 120_000_000) - positions_m(steady, 2000, 120_000_000)
    assert np.sqrt(np.mean(tremor_m**2)) == pytest.approx(rms_m, rel=0.02)
    power = np.abs(np.fft.rfft(tremor_m * np.hanning(len(tremor_m)))) ** 2
    frequency_hz = np.fft.rfftfreq(len(tremor_m), 0.002)
    in_band = (frequency_hz >= TREMOR_BAND_HZ[0] - 0.05) & (frequency_hz <= TREMOR_BAND_HZ[1] + 0.05)
    assert power[in_band].sum() / power.sum() > 0.9999


@pytest.mark.parametrize(
    "name",
    ["approach_m", "depth_m", "approach_s", "push_s", "pause_s", "withdraw_s", "rest_s", "variation", "tremor_rms_m"],
)
def test_settings_out_of_range_are_refused_by_name(name):
    for value in (math.nan, math.inf, -math.inf, 1e300, -1.0):
        with pytest.raises(SettingsError, match=f"insertion {name} is"):
            InsertionSettings(**{name: value})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("insertions", 0, ""),
        ("insertions", 10**9, ""),
        ("push_steps", 0, ""),
        ("approach_s", 0.0, ""),
        ("start_m", math.nan, ""),
        ("depth_m", 0.01, r" is 0\.01; it must be between 0\.014 and"),
    ],
)
def test_what_makes_no_motion_is_refused(name, value, message):
    with pytest.raises(SettingsError, match=name + message):
        InsertionSettings(**{name: value})


def palpating(seed=1, **settings):
    return PalpatingOperator(PalpationSettings(**settings), np.random.default_rng(seed))


def path_m(operator, period_us=1000):
    return np.array([operator.sample(t_us).position_m for t_us in range(0, operator.duration_us, period_us)])


@pytest.mark.parametrize("axes", [2, 3])
def test_it_presses_slides_along_the_surface_and_lifts(axes):
    settings = PalpationSettings(axes=axes, variation=0.0, tremor_rms_m=0.0, palpations=1)
    path = path_m(palpating(axes=axes, variation=0.0, tremor_rms_m=0.0, palpations=1))
    inward = np.array(settings.inward[:axes]) / np.linalg.norm(settings.inward[:axes])
    depth = (path - settings.surface_m[:axes]) @ inward
    assert depth[0] == pytest.approx(-settings.hover_m)
    assert depth[-1] == pytest.approx(-settings.hover_m)
    assert depth.max() == pytest.approx(settings.press_m)
    pressed = path[depth > settings.press_m - 1e-9]
    travelled = np.linalg.norm(np.diff(pressed, axis=0), axis=1).sum()
    assert travelled >= settings.strokes * settings.stroke_m * 0.99
    assert np.linalg.norm(pressed - pressed.mean(axis=0), axis=1).max() <= settings.stroke_m


def test_it_moves_without_jumps_and_rests_at_the_start_outside_the_script():
    operator = palpating(palpations=3)
    path = path_m(operator)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.3e-3
    assert operator.sample(-1).position_m == operator.sample(operator.duration_us).position_m
    assert path[0] == pytest.approx(operator.sample(-1).position_m, abs=5e-4)


def test_tremor_is_on_every_axis_with_its_strength():
    quiet, shaking = (path_m(palpating(tremor_rms_m=rms_m)) for rms_m in (0.0, 1e-4))
    tremor = shaking - quiet
    assert np.sqrt(np.mean(tremor**2, axis=0)) == pytest.approx([1e-4] * 3, rel=0.2)
    assert abs(np.corrcoef(tremor.T)[0, 1]) < 0.5


def test_the_default_palpation_feels_the_phantom_on_all_axes():
    scene, operator = make_scene(find_scene("phantom")), palpating()
    forces = np.array([scene.step(operator.sample(t_us)).force_n for t_us in range(0, operator.duration_us, 1000)])
    assert 2.0 < np.linalg.norm(forces, axis=1).max() < 5.0  # what the device can render
    assert (np.abs(forces).max(axis=0) > 0.5).all()
    assert not forces[0].any()
    assert not forces[-1].any()


def test_the_hand_for_a_scene_has_its_axes():
    for axes in (1, 2, 3):
        hand = scripted_hand(axes, 1, np.random.default_rng(1))
        assert hand.axes == axes == len(hand.sample(0).position_m)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"axes": 1}, "axes of the palpation is 1; it must be between 2 and 3"),
        ({"inward": (0.0, 0.0, 0.0)}, "length of palpation inward is 0.0"),
        ({"inward": (1.0, 0.0)}, "coordinates of palpation inward is 2"),
        ({"surface_m": (float("nan"), 0.0, 0.0)}, "palpation surface_m is nan"),
        ({"strokes": 0}, "palpation strokes is 0"),
        ({"variation": 0.6}, "palpation variation is 0.6"),
    ],
)
def test_a_motion_that_cannot_be_made_is_refused(settings, message):
    with pytest.raises(SettingsError, match=message):
        PalpationSettings(**settings)
