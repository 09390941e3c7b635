import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import SettingsError
from hapticnet.operator.scripted import TREMOR_BAND_HZ, InsertionSettings, ScriptedOperator

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


def test_the_default_script_takes_5_2_s_per_insertion():
    assert make(**STEADY, insertions=1).duration_us == 5_200_000
    assert make(insertions=200).duration_us == pytest.approx(200 * 5_200_000, rel=0.02)


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
    assert operator.duration_us == 15_600_000
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


def test_what_makes_no_motion_is_refused():
    zero = [("insertions", 0), ("insertions", 10**9), ("push_steps", 0), ("approach_s", 0.0), ("start_m", math.nan)]
    for name, value in zero:
        with pytest.raises(SettingsError, match=name):
            InsertionSettings(**{name: value})

    with pytest.raises(SettingsError, match=r"approach_m is -0\.01; it must be between 0 and"):
        InsertionSettings(approach_m=-0.01)
    with pytest.raises(SettingsError, match=r"depth_m is 0\.01; it must be between 0\.014 and"):
        InsertionSettings(depth_m=0.01)
