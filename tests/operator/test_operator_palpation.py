import numpy as np
import pytest

from hapticnet.errors import SettingsError
from hapticnet.operator.scripted import PalpatingOperator, PalpationSettings, scripted_hand
from hapticnet.scene.sources import find_scene, make_scene


def make(seed=1, **settings):
    return PalpatingOperator(PalpationSettings(**settings), np.random.default_rng(seed))


def path_m(operator, period_us=1000):
    return np.array([operator.sample(t_us).position_m for t_us in range(0, operator.duration_us, period_us)])


@pytest.mark.parametrize("axes", [2, 3])
def test_it_presses_slides_along_the_surface_and_lifts(axes):
    settings = PalpationSettings(axes=axes, variation=0.0, tremor_rms_m=0.0, palpations=1)
    path = path_m(make(axes=axes, variation=0.0, tremor_rms_m=0.0, palpations=1))
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
    operator = make(palpations=3)
    path = path_m(operator)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.3e-3
    assert operator.sample(-1).position_m == operator.sample(operator.duration_us).position_m
    assert path[0] == pytest.approx(operator.sample(-1).position_m, abs=5e-4)


def test_palpations_differ_and_repeat_with_the_seed():
    one, two, other = make(palpations=2), make(palpations=2), make(seed=2, palpations=2)
    assert np.array_equal(path_m(one), path_m(two))
    assert one.duration_us != other.duration_us


def test_tremor_is_on_every_axis_with_its_strength():
    quiet, shaking = (path_m(make(tremor_rms_m=rms_m)) for rms_m in (0.0, 1e-4))
    tremor = shaking - quiet
    assert np.sqrt(np.mean(tremor**2, axis=0)) == pytest.approx([1e-4] * 3, rel=0.2)
    assert abs(np.corrcoef(tremor.T)[0, 1]) < 0.5


def test_the_default_palpation_feels_the_phantom_on_all_axes():
    scene, operator = make_scene(find_scene("phantom")), make()
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
        ({"press_m": -1.0}, "palpation press_m is -1.0"),
        ({"strokes": 0}, "palpation strokes is 0"),
        ({"variation": 0.6}, "palpation variation is 0.6"),
    ],
)
def test_a_motion_that_cannot_be_made_is_refused(settings, message):
    with pytest.raises(SettingsError, match=message):
        PalpationSettings(**settings)
