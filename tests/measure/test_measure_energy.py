import numpy as np
import pytest

from hapticnet.measure.energy import EnergyReport, energy_report
from hapticnet.measure.quality import created_energy_j
from hapticnet.perception import WeberLaw

LAW = WeberLaw()
K = 400.0


def pressed(times=1, axes=1, rate=10_000):
    """A spring, pressed 10 mm deep and released, so many times."""
    position = 0.01 * np.sin(np.linspace(0.0, times * np.pi, rate * times + 1)).reshape(-1, 1) ** 2
    position = np.hstack([position, *[np.zeros_like(position)] * (axes - 1)]) - 1e-4
    return np.maximum(K * position, 0.0), position


def late(force, samples):
    return np.concatenate([np.zeros((samples, force.shape[1])), force[:-samples]])


@pytest.mark.parametrize("axes", [1, 3])
def test_the_true_force_creates_nothing_and_the_hand_does_the_springs_work(axes):
    force, position = pressed(axes=axes)
    found = energy_report(LAW, force, force, position)
    assert found.created_j == 0.0
    assert found.put_in_j == pytest.approx(0.5 * K * 0.0099**2, rel=0.01)
    assert found.active_share < 1e-3  # of being held from sample to sample


def test_a_late_spring_creates_energy_and_is_active_and_a_longer_delay_more():
    force, position = pressed()
    reports = [energy_report(LAW, force, late(force, samples), position) for samples in (50, 100, 200)]
    created = [report.created_share for report in reports]
    active = [report.active_share for report in reports]
    assert 0.0 < created[0] < created[1] < created[2]
    assert active == pytest.approx(created, rel=0.15)
    # At speed v(t) a delay T lowers the force by K·v·T: the work over the cycle is K·T·∫v² dt.
    speeds = np.diff(position, axis=0)
    assert created[1] * reports[1].put_in_j == pytest.approx(K * 100 * float(np.sum(speeds**2)), rel=0.02)


def test_a_force_that_always_resists_more_creates_nothing():
    force, position = pressed()
    against = np.sign(np.diff(position, axis=0, append=position[-1:]))
    found = energy_report(LAW, force, force + 0.2 * against * (force > 0.0), position)
    assert (found.created_j, found.active_j) == (0.0, 0.0)


def test_a_force_that_outlives_a_breach_does_not_pay_for_what_a_later_contact_creates():
    way = np.linspace(0.0, 0.02, 5000).reshape(-1, 1)
    broken = np.where(way < 0.01, K * way, 0.0)
    outlived = np.where(way < 0.015, np.minimum(K * way, 4.0), 0.0)
    force, position = pressed()
    true, applied = np.vstack([broken, force]), np.vstack([outlived, late(force, 100)])
    found = energy_report(LAW, true, applied, np.vstack([way, position]))
    alone = energy_report(LAW, force, late(force, 100), position)
    assert found.created_j == pytest.approx(alone.created_j, rel=1e-3)
    assert found.active_j == pytest.approx(alone.active_j, rel=1e-3)
    assert created_energy_j(true, applied, np.vstack([way, position])).max() < 0.1 * alone.created_j


def test_each_contact_counts_as_often_as_it_is_made():
    made = pressed(), pressed(times=3)
    one, three = (energy_report(LAW, force, late(force, 100), position) for force, position in made)
    assert three.created_j == pytest.approx(3 * one.created_j, rel=0.01)
    assert three.created_share == pytest.approx(one.created_share, rel=0.01)


def test_noise_below_the_floor_is_no_contact():
    force, position = np.full((100, 1), 0.5 * LAW.floor_n), np.linspace(0.0, 1.0, 100).reshape(-1, 1)
    assert energy_report(LAW, force, 0.0 * force, position) == EnergyReport(put_in_j=0.0, created_j=0.0, active_j=0.0)


@pytest.mark.parametrize("samples", [0, 1])
def test_without_motion_there_is_no_energy(samples):
    nothing = np.ones((samples, 2))
    report = energy_report(LAW, nothing, nothing, nothing)
    assert (report.put_in_j, report.created_share, report.active_share) == (0.0, 0.0, 0.0)
