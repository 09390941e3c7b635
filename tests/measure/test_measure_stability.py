import math

import numpy as np
import pytest

from hapticnet.errors import SettingsError
from hapticnet.measure.stability import onset, sampled_onset
from hapticnet.operator.yielding import HANDS
from hapticnet.oscillator import exact_step

ARM = HANDS["arm"]
OF_ARM = ARM.mass_kg, ARM.damping_n_s_per_m, ARM.stiffness_n_per_m


def radius(step, late_ticks, stiffness):
    """Return the spectral radius of the loop from tick to tick, with the past positions as states."""
    xx, xv, xf, vx, vv, vf = step
    loop = np.diag(np.ones(late_ticks + 1), -1)
    loop[:2] = loop[2, 1] = 0.0
    loop[:2, :2] = (xx, xv), (vx, vv)
    if late_ticks:
        loop[2, 0] = 1.0
    oldest = 1 + late_ticks if late_ticks else 0
    loop[:2, oldest] -= stiffness * xf, stiffness * vf
    return float(np.abs(np.linalg.eigvals(loop)).max())


@pytest.mark.parametrize(
    ("delay_s", "stiffness", "hz"),
    [(0.01, 660, 5.9), (0.02, 340, 4.4), (0.05, 153, 3.2), (0.1, 101, 2.5), (0.2, 97, 1.8)],
)
def test_a_measured_arm_swings_above_these_stiffnesses(delay_s, stiffness, hz):
    found = onset(*OF_ARM, delay_s)
    assert found == (pytest.approx(stiffness, abs=0.5), pytest.approx(hz, abs=0.05))


def test_a_spring_without_delay_lets_no_hand_swing():
    assert onset(*OF_ARM, 0.0).stiffness_n_per_m == math.inf
    with pytest.raises(SettingsError, match="delay is -1 s; it must be between 0 and 100 s"):
        onset(*OF_ARM, -1)


def test_the_equation_holds_at_the_onset_also_where_the_spring_meets_a_resonance():
    rng = np.random.default_rng(1)
    for mass, damping, stiffness, delay in 10.0 ** rng.uniform((-2, -1, 1, -3), (1, 2, 3, -0.5), (200, 4)):
        found = onset(mass, damping, stiffness, delay)
        s = 2j * math.pi * found.frequency_hz
        left = mass * s * s + damping * s + stiffness + found.stiffness_n_per_m * np.exp(-s * delay)
        assert abs(left) < 1e-6 * found.stiffness_n_per_m
        # A finer search finds no softer spring.
        omega = np.linspace(1e-3, 1.5 * abs(s), 20_001)
        spring = -(stiffness - mass * omega**2 + 1j * damping * omega) * np.exp(1j * omega * delay)
        crosses = np.flatnonzero((np.diff(np.sign(spring.imag)) != 0) & (spring.real[1:] > 0))
        assert np.abs(spring[crosses]).min() > 0.95 * found.stiffness_n_per_m


def test_the_sampled_onset_is_where_the_loop_from_tick_to_tick_becomes_unstable():
    rng = np.random.default_rng(2)
    for mass, damping, stiffness, step_s in 10.0 ** rng.uniform((-6, -4, 0, -4), (1, 2, 6, -1.4), (150, 4)):
        late_ticks = int(rng.integers(0, 60))
        step = exact_step(mass, damping, stiffness, step_s)
        spring = sampled_onset(mass, damping, stiffness, step_s, late_ticks).stiffness_n_per_m
        assert radius(step, late_ticks, 0.999 * spring) < 1.0 < radius(step, late_ticks, 1.001 * spring)


@pytest.mark.parametrize("delay_ms", [10, 50, 200])
def test_the_sampled_loop_is_like_a_delay_that_is_half_a_tick_longer(delay_ms):
    sampled = sampled_onset(*OF_ARM, 1e-3, delay_ms)
    assert sampled == pytest.approx(onset(*OF_ARM, (delay_ms + 0.5) * 1e-3), rel=1e-3)
