"""The bound on the force from the energy at the master's port."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.couplings import EnergyBounded, make_coupling, parse_coupling
from hapticnet.control.ports import Port
from hapticnet.errors import SettingsError
from hapticnet.perception import WeberLaw

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
STIFFEST = 2000.0  # of a tick of 1 ms and a damping of 1 N·s/m


def bound(axes=1, max_force_n=math.inf, **parameters):
    return EnergyBounded(**parameters).master(Port(axes, LAW, 1000, max_force_n))


def applied(end, forces, positions, follows=True):
    samples = zip(forces.tolist(), positions.tolist(), strict=True)
    return np.array(
        [end.limit(tuple(f), tuple(x), 1000 * t, follows=follows) for t, (f, x) in enumerate(samples)]
    ).reshape(forces.shape)


def presses(stiffness, delay, speed_hz=1.0, samples=6000, axes=1):
    """Return the delayed force of a spring, and the hand's positions."""
    depth = 0.01 * np.sin(2 * math.pi * speed_hz * 1e-3 * np.arange(samples))
    positions = depth[:, None] * np.array([1.0, -0.4, 0.2])[:axes]
    forces = stiffness * np.clip(positions, 0.0, None)
    return np.concatenate([np.zeros((delay, axes)), forces[: samples - delay]]), positions


@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("stiffness", [100.0, 500.0, 1500.0])
def test_a_true_spring_that_a_tick_can_render_is_not_changed(stiffness, axes):
    forces, positions = presses(stiffness, 0, axes=axes)
    assert np.abs(applied(bound(axes), forces, positions) - forces).max() < LAW.floor_n


@pytest.mark.parametrize("delay", [10, 50, 100])
def test_a_late_spring_gives_no_more_than_was_put_in_and_the_allowance(delay):
    forces, positions = presses(400.0, delay)
    given_n = applied(bound(), forces, positions, follows=False)
    moves = np.diff(positions[:, 0])
    credit_j = 1e-3 + np.cumsum(given_n[:-1, 0] * moves + 1.0 * moves**2 / 1e-3)
    drawn_j = np.cumsum(forces[:-1, 0] * moves)
    assert drawn_j.min() < -5e-3, "the late force would give more"
    # The energy of the last move is only known after it, as a device holds its force until the next tick.
    assert credit_j.min() > -2.0 * np.abs(forces).max() * np.abs(moves).max()


@given(st.integers(0, 10_000), st.integers(1, 3), st.sampled_from([0.0, 1e-12, 1e-6, 1e-4, 1.0]))
def test_the_force_is_never_larger_nor_turned_and_stays_within_the_energy_and_the_device(seed, axes, step):
    rng = np.random.default_rng(seed)
    forces = rng.normal(0.0, rng.choice([0.01, 1.0, 1e3]), (100, axes))
    positions = np.cumsum(rng.normal(0.0, step, (100, axes)), axis=0)
    end = bound(axes, max_force_n=3.0)
    for t, (force, position) in enumerate(zip(forces.tolist(), positions.tolist(), strict=True)):
        got = np.array(end.limit(tuple(force), tuple(position), 1000 * t, follows=True))
        size = np.linalg.norm(got)
        assert size <= min(np.linalg.norm(force), 3.0) * (1 + 1e-12)
        assert size <= math.sqrt(2.0 * STIFFEST * end.energy_j) * (1 + 1e-9)
        assert np.dot(got, force) >= 0.0
        assert math.isfinite(end.energy_j)


def test_a_wall_that_a_tick_cannot_render_is_displayed_as_the_stiffest_that_it_can():
    positions = np.linspace(-0.001, 0.004, 5000)[:, None]
    forces = 1e6 * np.clip(positions, 0.0, None)
    given_n = applied(bound(allowance_mj=0.001), forces, positions)
    inside = positions[:, 0] > 0.001
    slope = np.polyfit(positions[inside, 0], given_n[inside, 0], 1)[0]
    assert slope == pytest.approx(STIFFEST, rel=0.02)


def test_a_late_force_is_held_back_until_it_has_followed_the_hand_for_a_while():
    late = bound()
    rest = (0.01,)
    begun = [late.limit((0.0,), (0.01 * t / 300,), 1000 * t, follows=True)[0] for t in range(301)]
    assert set(begun) == {0.0}
    forces = [late.limit((6.0,), rest, 1000 * t, follows=True)[0] for t in range(301, 2500)]
    assert forces[0] == pytest.approx(math.sqrt(2.0 * STIFFEST * 1e-3))
    assert forces[290] == forces[0]
    assert forces[-1] == pytest.approx(6.0, rel=0.01)
    assert 0.1 < late.report()["held_back_share"] < 1.0


def test_a_held_force_is_never_confirmed():
    held = bound()
    held.limit((0.0,), (0.01,), 0, follows=False)
    assert held.limit((6.0,), (0.01,), 5_000_000, follows=False)[0] == pytest.approx(2.0, rel=1e-6)


def test_what_a_breach_absorbed_does_not_pay_for_a_later_force():
    end = bound()
    pushed = np.concatenate([np.linspace(0.0, 0.02, 500), np.full(500, 0.02)])[:, None]
    forces = np.where(pushed < 0.0199, 300.0 * pushed, 0.0)
    applied(end, forces, pushed)
    assert end.energy_j <= 1e-3


def test_a_pause_credits_nothing():
    end = bound()
    end.limit((1.0,), (0.0,), 0, follows=True)
    end.limit((1.0,), (0.0,), 1000, follows=True)
    before_j = end.energy_j
    end.limit((1.0,), (-1e-4,), 10_000_000, follows=True)
    assert end.energy_j == pytest.approx(before_j - 1e-4)


def test_names_and_parameters_are_checked():
    assert parse_coupling("energy-bounded: damping=2, allowance_mj=0.5") == EnergyBounded(2.0, 0.5)
    assert parse_coupling("direct").master(Port(1, LAW, 1000, math.inf)) is None
    with pytest.raises(SettingsError, match="energy-bounded"):
        parse_coupling("energy-bound")
    with pytest.raises(SettingsError, match=r"'dampin' \(did you mean 'damping'"):
        parse_coupling("energy-bounded:dampin=2")
    with pytest.raises(SettingsError, match="must be KEY=NUMBER"):
        parse_coupling("energy-bounded:damping")
    with pytest.raises(SettingsError, match="damping of hand and device"):
        make_coupling("energy-bounded", {"damping": -1.0}).master(Port(1, LAW, 1000, math.inf))


def test_the_account_counts_what_the_device_applies_and_how_far_the_hand_moves():
    said = [(1.0,)]
    end = EnergyBounded().master(Port(1, LAW, 1000, math.inf, scale=2.0, applied_n=lambda: said[0]))
    end.limit((2.0,), (0.0,), 0, follows=False)
    before_j = end.energy_j
    said[0] = (0.5,)
    end.limit((2.0,), (-2e-4,), 1000, follows=False)  # the hand moved by half of it
    assert end.energy_j == pytest.approx(before_j - 0.5 * 1e-4 + 1e-3 * (0.1 * 0.1) ** 2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_force_that_is_no_number_is_zero_and_leaves_the_account_as_it_was(bad):
    end = bound()
    for t in range(3):
        end.limit((1.0,), (1e-4 * t,), 1000 * t, follows=True)
    before_j = end.energy_j
    assert end.limit((bad,), (3e-4,), 3000, follows=True) == (0.0,)
    assert end.energy_j == before_j
    assert end.limit((1e3,), (3e-4,), 4000, follows=False)[0] < 3.0
