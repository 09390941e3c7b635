"""A model of the contact ahead is the scene's own physics, begun in any state, and says what is allowed or nothing."""

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.errors import SampleError
from hapticnet.samples import PositionSample
from hapticnet.scene.ahead import (
    LARGEST_FORCE_N,
    MOST_LAYERS,
    REACH_M,
    ContactModel,
    LayerAhead,
    check_layers,
    stiffest_at,
)
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Plane, Sphere, Tissue
from hapticnet.scene.sources import find_scene

SPRING = LayerAhead(0.02, 500.0, 2.0)


def maybe(values):
    return st.one_of(st.just(0.0), values)


@st.composite
def tissues(draw):
    places = draw(st.lists(st.integers(1, 40), min_size=1, max_size=4, unique=True))
    return [
        Tissue(
            name=f"tissue {place}",
            rest_position_m=place * 1e-3,
            stiffness_n_per_m=draw(st.floats(50.0, 2000.0)),
            breach_force_n=draw(st.floats(0.2, 5.0)),
            viscosity_n_s_per_m=draw(maybe(st.floats(0.1, 20.0))),
            shaft_friction_n=draw(maybe(st.floats(0.05, 1.0))),
            stiffening_per_m=draw(maybe(st.floats(1.0, 300.0))),
            recovery_time_s=draw(maybe(st.floats(0.01, 1.0))),
        )
        for place in places
    ]


def motion(draw):
    """Return positions [m] with their times [µs]: a hand that goes in and out, and jumps now and then."""
    targets = draw(st.lists(st.floats(-0.01, 0.06), min_size=2, max_size=6))
    steps = draw(st.integers(5, 40))
    places = [a + (b - a) * k / steps for a, b in itertools.pairwise(targets) for k in range(steps)]
    return [(1000 * (k + 1), (x,)) for k, x in enumerate(places)]


@given(tissues(), st.data())
@settings(max_examples=60, deadline=None)
def test_a_model_that_begins_anywhere_feels_like_the_scene(layers, data):
    scene = Scene(layers, reach_m=1.0)
    path = motion(data.draw)
    begin = data.draw(st.integers(0, len(path) - 1))
    model = None
    for index, (t_us, position) in enumerate(path):
        true_n = scene.step(PositionSample(t_us, position)).force_n
        if model is not None:
            assert model.step(t_us, position) == pytest.approx(true_n, rel=1e-6, abs=1e-6)
        if index == begin:
            model = ContactModel(scene.ahead(), t_us, position, path[index - 1] if index else None)
            assert model.force_n == pytest.approx(true_n, rel=1e-6, abs=1e-6)


def test_planes_on_three_axes_feel_like_the_scene():
    plane = Plane(name="wall", stiffness_n_per_m=800.0, point_m=(0.0, 0.0, 0.01), inward=(0.0, 0.6, 0.8))
    scene = BodyScene([plane])
    first = PositionSample(0, (0.0, 0.0, 0.0))
    assert scene.step(first).force_n == (0.0, 0.0, 0.0)
    model = ContactModel(scene.ahead(), *first, None)
    for k in range(1, 60):
        sample = PositionSample(1000 * k, (1e-3 * math.sin(k), 1e-4 * k, 5e-4 * k))
        assert model.step(*sample) == pytest.approx(scene.step(sample).force_n, abs=1e-9)
    assert math.hypot(*model.force_n) > 5.0


def test_a_sphere_is_announced_as_the_plane_that_touches_it_where_the_tool_is_nearest():
    scene = BodyScene([Sphere(name="ball", stiffness_n_per_m=300.0, centre_m=(0.0, 0.05), radius_m=0.03)])
    scene.step(PositionSample(0, (0.0, 0.01)))
    (layer,) = scene.ahead()
    assert layer.normal == pytest.approx((0.0, 1.0))
    assert layer.surface_m == pytest.approx(0.02)


def test_the_scene_announces_what_is_within_reach_the_nearest_first():
    scene = Scene(find_scene("paper:0").tissues)
    scene.step(PositionSample(0, (0.055,)))
    assert [layer.surface_m for layer in scene.ahead()] == [0.06, 0.04, 0.02]
    scene.step(PositionSample(1000, (0.06 - REACH_M - 0.001,)))
    assert [layer.surface_m for layer in scene.ahead()] == [0.02, 0.04]


def test_a_model_takes_over_the_state_that_another_reports():
    model = ContactModel((SPRING,), 0, (0.0,), None)
    model.step(1000, (0.023,))
    assert (model.state, model.force_n) == (0, pytest.approx((1.5,)))
    model.adopt(1)
    assert (model.state, model.force_n) == (1, (0.0,))
    assert model.step(2000, (0.01,)) == (0.0,)
    assert model.state == 0, "it heals when the tool is withdrawn"


def test_foretelling_changes_nothing():
    model = ContactModel((SPRING,), 0, (0.022,), None)
    assert model.predict(30_000, (0.0241,)) == (0.0,), "it would breach at 24 mm"
    assert (model.state, model.force_n) == (0, pytest.approx((1.0,)))


def test_a_force_is_finite_at_any_position():
    layers = [LayerAhead(0.0, 9e3), LayerAhead(0.0, 1.0, 1e6, 0.0, 0.009)]
    assert ContactModel(layers, 0, (1e15,), None).force_n[0] <= 2 * LARGEST_FORCE_N


@given(st.floats(0.1, 1000.0), st.floats(1.0, 9000.0), st.one_of(st.just(math.inf), st.floats(0.1, 1e6)))
def test_no_layer_is_stiffer_than_it_says(stiffening, stiffness, breach_n):
    layer = LayerAhead(0.0, stiffness, breach_n, stiffening_per_m=stiffening)
    at_most_n = min(breach_n, LARGEST_FORCE_N)
    places = [math.log1p(stiffening * share * at_most_n / stiffness) / stiffening for share in (0.9, 0.999, 1.001, 2.0)]
    for place in places:
        model = ContactModel([layer], 0, (place,), None)
        (force_n,) = model.force_n
        (further_n,) = model.step(1000, (place + 1e-7,))
        assert (further_n - force_n) / 1e-7 <= layer.stiffest_n_per_m * 1.001 + 1.0


@pytest.mark.parametrize(
    "layer",
    [
        SPRING._replace(stiffness_n_per_m=1e6),
        SPRING._replace(stiffness_n_per_m=-1.0),
        SPRING._replace(stiffness_n_per_m=math.nan),
        SPRING._replace(surface_m=math.inf),
        SPRING._replace(breach_force_n=0.0),
        SPRING._replace(breach_force_n=2e6),
        SPRING._replace(viscosity_n_s_per_m=101.0),
        SPRING._replace(stiffening_per_m=1e4),
        SPRING._replace(stiffening_per_m=10.0, breach_force_n=math.inf),
        SPRING._replace(raised_m=-1e-3),
        SPRING._replace(normal=(0.5,)),
        SPRING._replace(normal=(0.0, 1.0)),
    ],
)
def test_what_is_not_allowed_is_refused(layer):
    with pytest.raises(SampleError):
        check_layers([layer], 1, stiffest_at(1000.0))


def test_all_layers_together_have_limits():
    check_layers([SPRING] * MOST_LAYERS, 1, stiffest_at(1000.0))
    with pytest.raises(SampleError, match="9 layers"):
        check_layers([SPRING] * (MOST_LAYERS + 1), 1, stiffest_at(1000.0))
    with pytest.raises(SampleError, match="1000 N/m together; at most 500 N/m"):
        check_layers([SPRING] * 2, 1, stiffest_at(50.0))
