"""A robot's own measurements tell where the contact is, how stiff, and at which force it broke."""

import itertools

import numpy as np
import pytest

from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.measured import LineFit, MeasuredScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import find_scene


class Hidden:
    """The paper's scene, with noise and without a word of what it is."""

    name, axes, breaches = "hidden", 1, 0

    def __init__(self, noise_n=0.0):
        self._scene = Scene(find_scene("paper:1").tissues)
        self._rng, self._noise_n = np.random.default_rng(1), noise_n

    def step(self, sample):
        (force_n,) = self._scene.step(sample).force_n
        return ForceSample(sample.t_us, (force_n + self._rng.normal(0.0, self._noise_n),))


def press(scene, *stops_m, speed_m_per_s=0.05):
    """Move from stop to stop, and return what is announced at the end."""
    places = [np.arange(a, b, np.sign(b - a) * 1e-3 * speed_m_per_s) for a, b in itertools.pairwise(stops_m)]
    for index, x in enumerate(np.concatenate(places).tolist()):
        scene.step(PositionSample(1000 * index, (x,)))
    return scene.ahead()


FIRST = find_scene("paper:1").tissues[0]


def test_nothing_is_known_before_the_first_contact():
    assert press(MeasuredScene(Hidden()), 0.0, 0.019) == ()


@pytest.mark.parametrize("noise_n", [0.0, 0.002, 0.005])
def test_a_contact_is_announced_soon_after_it_began(noise_n):
    (layer,) = press(MeasuredScene(Hidden(noise_n)), 0.0, FIRST.rest_position_m + 2e-3)
    assert layer.stiffness_n_per_m == pytest.approx(FIRST.stiffness_n_per_m, rel=0.1)
    assert layer.surface_m == pytest.approx(FIRST.rest_position_m, abs=3e-4)
    assert not layer.pierced


def test_it_cannot_tell_while_the_stiffness_is_uncertain():
    scene = MeasuredScene(Hidden(0.005))
    assert press(scene, 0.0, FIRST.rest_position_m + 2e-4) is None


@pytest.mark.parametrize("noise_n", [0.0, 0.005])
def test_a_breach_is_remembered_with_its_force(noise_n):
    scene = MeasuredScene(Hidden(noise_n))
    (layer,) = press(scene, 0.0, FIRST.rest_position_m + FIRST.breach_depth_m + 1e-3)
    assert layer.pierced
    assert layer.breach_force_n == pytest.approx(FIRST.breach_force_n, rel=0.03)
    (again,) = press(scene, 0.03, 0.0)
    assert not again.pierced, "it heals when the tool is withdrawn"
    assert again.breach_force_n == layer.breach_force_n


def test_all_surfaces_of_an_insertion_are_known_the_second_time():
    scene = MeasuredScene(Hidden())
    press(scene, 0.0, 0.074, 0.0)
    found = sorted(press(scene, 0.0, 0.001))
    true = sorted(find_scene("paper:1").tissues, key=lambda tissue: tissue.rest_position_m)
    assert [layer.surface_m for layer in found] == pytest.approx([each.rest_position_m for each in true], abs=1e-4)
    assert [layer.breach_force_n for layer in found] == pytest.approx([each.breach_force_n for each in true], rel=0.01)


def test_a_hand_at_rest_keeps_what_it_knows():
    fit = LineFit(0.0, 1.0)
    for k in range(1, 20):
        fit.add(1e-4 * k, 1.0 + 0.05 * k)
    before = fit.stiffness_n_per_m
    for _ in range(1000):
        fit.add(1.9e-3, 1.95)
    assert before == pytest.approx(500.0)
    assert fit.stiffness_n_per_m == pytest.approx(500.0)
    assert fit.is_sure


def test_a_rigid_wall_is_not_announced():
    fit = LineFit(0.0, 1.0)
    for k in range(1, 20):
        fit.add(1e-7 * k, 1.0 + 0.1 * k)
    assert not fit.is_sure


def test_two_axes_pass_through():
    class Flat:
        name, axes = "flat", 2

        def step(self, sample):
            return ForceSample(sample.t_us, (1.0, 0.0))

    scene = MeasuredScene(Flat())
    assert scene.step(PositionSample(0, (0.0, 0.0))).force_n == (1.0, 0.0)
    assert scene.ahead() is None
