"""The passivity observer and controller of one port."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.measure.energy import energy_report
from hapticnet.perception import WeberLaw
from hapticnet_literature.observer import PassivityController

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)


def limited(forces, positions):
    controller = PassivityController(forces.shape[1], LAW.floor_n)
    applied = [
        controller.limit(tuple(force), tuple(position), 0, follows=False)
        for force, position in zip(forces.tolist(), positions.tolist(), strict=True)
    ]
    return np.array(applied), controller


def presses(stiffness, delay, axes=1, speed_hz=1.0, samples=4000):
    """Return the delayed force of a spring, and the hand's positions."""
    depth = 0.01 * np.sin(2 * math.pi * speed_hz * 1e-3 * np.arange(samples))
    position = depth[:, None] * np.array([1.0, -0.4, 0.2])[:axes]
    force = stiffness * np.clip(position, 0.0, None)
    return np.concatenate([np.zeros((delay, axes)), force[: samples - delay]]), position


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("delay", [10, 50, 100])
def test_a_delayed_spring_creates_hardly_any_energy(axes, delay):
    force, position = presses(400.0, delay, axes)
    applied, controller = limited(force, position)
    before, after = (energy_report(LAW, force, each, position) for each in (force, applied))
    assert before.active_share > 0.05
    assert after.active_share < 0.1 * before.active_share
    assert controller.damped_j > 0.0


def test_a_true_spring_keeps_its_force_until_the_hand_has_nearly_left_it():
    force, position = presses(400.0, 0)
    applied, _ = limited(force, position)
    assert np.abs(applied - force).max() < LAW.floor_n


def test_what_takes_up_energy_is_left_alone():
    """A breach: the force falls to zero while the hand pushes on. Then friction against the motion."""
    position = np.concatenate([np.linspace(0.0, 0.02, 500), np.linspace(0.02, 0.0, 500)])[:, None]
    force = np.where(position < 0.01, 300.0 * position, 0.0)
    force[500:] = -0.3
    applied, controller = limited(force, position)
    assert np.array_equal(applied, force)
    assert controller.damped_j == 0.0


@given(st.integers(0, 10_000), st.integers(1, 3))
def test_damping_is_finite_and_never_exceeds_the_force(seed, axes):
    rng = np.random.default_rng(seed)
    force = rng.normal(0.0, rng.choice([0.01, 1.0, 1e3]), (200, axes))
    position = np.cumsum(rng.normal(0.0, rng.choice([0.0, 1e-12, 1e-4, 1.0]), (200, axes)), axis=0)
    applied, _ = limited(force, position)
    change = np.linalg.norm(applied - force, axis=1)
    assert np.isfinite(applied).all()
    assert (change <= np.linalg.norm(force, axis=1) * (1 + 1e-9)).all()


def test_each_contact_has_an_account_of_its_own():
    controller = PassivityController(1, LAW.floor_n)
    for depth in (0.0, 0.001, 0.002):
        controller.limit((1.0,), (depth,), 0, follows=False)
    assert controller.energy_j > 0.0
    for depth in (0.001, 0.0):
        controller.limit((0.0,), (depth,), 0, follows=False)
    assert controller.energy_j == 0.0
    for _ in range(100):  # at rest nothing changes
        assert controller.limit((2.0,), (0.01,), 0, follows=False) == (2.0,)
