import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import SettingsError
from hapticnet.experiment.step_response import StepFigures, step_figures

AT_S = 0.5


def first_order(t_s, tau_s):
    return np.where(t_s >= AT_S, 1.0 - np.exp(-np.maximum(t_s - AT_S, 0.0) / tau_s), 0.0)


def second_order(t_s, damping, natural_rad_s):
    since_s = np.maximum(t_s - AT_S, 0.0)
    damped = natural_rad_s * math.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * natural_rad_s * since_s)
    swing = np.cos(damped * since_s) + damping * natural_rad_s / damped * np.sin(damped * since_s)
    return np.where(t_s >= AT_S, 1.0 - decay * swing, 0.0)


def figures_of(done, t_s, from_n=0.4, to_n=2.0):
    return step_figures(t_s, from_n + (to_n - from_n) * done, at_s=AT_S, from_n=from_n, to_n=to_n)


@given(st.floats(0.02, 0.2), st.floats(0.0, 4.0), st.floats(0.1, 4.0), st.booleans())
def test_a_first_order_lag_rises_in_2_2_and_settles_in_3_time_constants(tau_s, from_n, height_n, down):
    t_s = np.arange(0.0, AT_S + 12.0 * tau_s, 0.001)
    figures = figures_of(first_order(t_s, tau_s), t_s, from_n, from_n - height_n if down else from_n + height_n)
    assert figures.rise_s == pytest.approx(math.log(9.0) * tau_s, rel=1e-3)
    assert figures.settling_s == pytest.approx(math.log(20.0) * tau_s, rel=1e-3)
    assert figures.overshoot == 0.0
    assert abs(figures.steady_error_n) < 1e-3 * height_n
    assert 0.0 < figures.ripple_peak_to_peak_n < 1e-3 * height_n


@given(st.floats(0.2, 0.6), st.booleans())
def test_an_underdamped_second_order_overshoots_by_the_formula(damping, down):
    natural_rad_s = 40.0
    t_s = np.arange(0.0, 3.0, 0.0005)
    figures = figures_of(second_order(t_s, damping, natural_rad_s), t_s, *((2.0, 0.4) if down else (0.4, 2.0)))
    assert figures.overshoot == pytest.approx(math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2)), abs=1e-3)
    assert figures.settling_s is not None
    # The envelope is within 5 % from here on; the response at some time within its last half swing before.
    envelope_s = -math.log(0.05 * math.sqrt(1.0 - damping**2)) / (damping * natural_rad_s)
    assert envelope_s - math.pi / natural_rad_s / math.sqrt(1.0 - damping**2) < figures.settling_s <= envelope_s


def test_a_rate_limited_response_is_measured_between_samples():
    t_s = np.arange(0.0, 2.0, 0.03)
    figures = figures_of(np.clip((t_s - AT_S) / 0.5, 0.0, 1.0), t_s)
    assert figures.rise_s == pytest.approx(0.4)
    assert figures.settling_s == pytest.approx(0.475)


def test_what_is_never_reached_is_none():
    t_s = np.arange(0.0, 2.0, 0.001)
    nothing = figures_of(np.zeros_like(t_s), t_s)
    assert nothing == StepFigures(
        rise_s=None,
        overshoot=0.0,
        settling_s=None,
        steady_error_n=pytest.approx(-1.6),
        ripple_peak_to_peak_n=0.0,
        ripple_rms_n=pytest.approx(0.0, abs=1e-12),
    )
    half = figures_of(0.5 * first_order(t_s, 0.05), t_s)
    assert (half.rise_s, half.settling_s) == (None, None)
    short = figures_of(0.93 * first_order(t_s, 0.05), t_s)
    assert short.rise_s is not None
    assert short.settling_s is None
    assert short.steady_error_n == pytest.approx(-0.07 * 1.6, abs=1e-4)


def test_what_leaves_the_band_at_the_end_has_not_settled():
    t_s = np.arange(0.0, 2.0, 0.001)
    done = first_order(t_s, 0.05)
    done[-1] = 1.06
    assert figures_of(done, t_s).settling_s is None
    done[-1] = 1.04
    assert figures_of(done, t_s).settling_s == pytest.approx(3 * 0.05, rel=0.01)


def test_an_immediate_response_takes_no_time():
    t_s = np.arange(0.0, 2.0, 0.001)
    figures = figures_of((t_s >= AT_S).astype(float), t_s)
    assert (figures.rise_s, figures.overshoot, figures.settling_s) == (0.0, 0.0, 0.0)
    already = figures_of(np.ones_like(t_s), t_s)
    assert (already.rise_s, already.settling_s) == (0.0, 0.0)


def test_ripple_and_steady_error_are_of_the_last_quarter():
    t_s = np.arange(0.0, AT_S + 2.0, 0.001)
    wave = np.where(t_s >= AT_S + 1.0, 0.02 * np.sin(2.0 * math.pi * 8.0 * (t_s - AT_S)), 0.0)
    figures = step_figures(t_s, np.where(t_s >= AT_S, 2.03, 0.4) + wave, at_s=AT_S, from_n=0.4, to_n=2.0)
    assert figures.steady_error_n == pytest.approx(0.03, abs=1e-3)
    assert figures.ripple_peak_to_peak_n == pytest.approx(0.04, rel=0.01)
    assert figures.ripple_rms_n == pytest.approx(0.02 / math.sqrt(2.0), rel=0.01)


def test_what_happened_before_the_step_does_not_count():
    t_s = np.arange(0.0, 2.0, 0.001)
    calm = figures_of(first_order(t_s, 0.05), t_s)
    done = first_order(t_s, 0.05)
    done[t_s < AT_S - 0.01] = 7.0
    assert figures_of(done, t_s) == calm


@pytest.mark.parametrize(
    ("t_s", "force_n", "step", "message"),
    [
        ([0.0, 1.0, 2.0], [1.0, 1.0, 1.0], (0.0, 2.0, 2.0), "from 2 to 2 N; the forces must differ"),
        ([0.0, 1.0, 2.0], [1.0, 1.0, 1.0], (1.5, 0.4, 2.0), "1 samples follow the step at 1.5 s"),
        ([], [], (0.0, 0.4, 2.0), "0 samples follow"),
    ],
)
def test_records_without_a_step_are_refused(t_s, force_n, step, message):
    at_s, from_n, to_n = step
    with pytest.raises(SettingsError, match=message):
        step_figures(t_s, force_n, at_s=at_s, from_n=from_n, to_n=to_n)
