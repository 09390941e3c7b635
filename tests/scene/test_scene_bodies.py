"""A tool on planes and spheres: closed forms, friction, energy and hard inputs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.errors import SampleError, SettingsError
from hapticnet.samples import PositionSample, Vector
from hapticnet.scene.bodies import LARGEST_FORCE_N, BodyScene
from hapticnet.scene.settings import AnyBody, Contact, Plane, Sphere

K = 500.0


def plane(*, axes: int = 3, inward: Vector = (1.0, 0.0, 0.0), **changes: float) -> Plane:
    plain = {"stiffness_n_per_m": K} | changes
    return Plane(name="plane", point_m=(0.0,) * axes, inward=inward[:axes], **plain)


def ball(**changes: float) -> Sphere:
    plain = {"stiffness_n_per_m": K, "radius_m": 0.1} | changes
    return Sphere(name="ball", centre_m=(0.1, 0.0, 0.0), **plain)


def forces(body: AnyBody, path_m: list[Vector], period_us: int = 1000) -> np.ndarray:
    scene = BodyScene([body])
    return np.array([scene.step(PositionSample(k * period_us, at)).force_n for k, at in enumerate(path_m)])


# Closed forms without friction ----------------------------------------------------------------------------


@given(st.tuples(*[st.floats(-0.05, 0.05)] * 3))
def test_a_plane_pushes_along_its_normal_with_stiffness_times_depth(tool_m: Vector) -> None:
    inward = np.array([2.0, 1.0, -1.0]) / math.sqrt(6.0)
    (force_n,) = forces(plane(inward=(2.0, 1.0, -1.0)), [tool_m])
    assert force_n == pytest.approx(K * max(inward @ tool_m, 0.0) * inward, abs=1e-12)


@given(st.tuples(*[st.floats(-0.1, 0.2)] * 3))
def test_a_sphere_pushes_along_its_radius_with_stiffness_times_depth(tool_m: Vector) -> None:
    away = np.array(tool_m) - (0.1, 0.0, 0.0)
    distance_m = np.linalg.norm(away)
    (force_n,) = forces(ball(), [tool_m])
    assert np.linalg.norm(force_n) == pytest.approx(K * max(0.1 - distance_m, 0.0), abs=1e-9)
    assert force_n @ away <= 1e-12


def test_on_two_axes_the_forces_are_those_of_three_with_a_zero() -> None:
    path_m = [(0.001 * k, 0.0005 * k) for k in range(-5, 20)]
    flat = forces(plane(axes=2, inward=(0.8, 0.6), friction=0.3), path_m)
    deep = forces(plane(inward=(0.8, 0.6, 0.0), friction=0.3), [(*at, 0.0) for at in path_m])
    assert np.array_equal(flat, deep[:, :2])
    assert not deep[:, 2].any()


def test_bodies_act_in_parallel() -> None:
    at = PositionSample(0, (0.004, 0.002, 0.0))
    both = BodyScene([plane(friction=0.2), ball()]).step(at).force_n
    each = [BodyScene([body]).step(at).force_n for body in (plane(friction=0.2), ball())]
    assert both == pytest.approx(np.sum(each, axis=0), abs=1e-12)


# Friction -------------------------------------------------------------------------------------------------


def test_a_tool_sticks_like_a_spring_until_the_cone_is_left_and_on_the_way_back_for_twice_the_length() -> None:
    depth_m, friction = 0.004, 0.3
    out = [(depth_m, 1e-5 * k, 0.0) for k in range(300)]
    found = forces(plane(friction=friction), out + out[::-1])
    dragged_n = K * friction * depth_m
    expected = [min(K * 1e-5 * k, dragged_n) for k in range(300)]
    expected += [max(dragged_n - K * 1e-5 * k, -dragged_n) for k in range(300)]
    assert found[:, 1] == pytest.approx(expected, abs=1e-9)
    assert found[:, 0] == pytest.approx(K * depth_m)


def test_greater_static_friction_makes_the_tool_stick_and_slip_between_both_cones() -> None:
    depth_m = 0.004
    path_m = [(depth_m, 1e-5 * k, 0.0) for k in range(2000)]
    found = forces(plane(friction=0.2, static_friction=0.4), path_m)[200:, 1]
    assert found.max() == pytest.approx(K * 0.4 * depth_m, rel=0.01)
    assert found.min() == pytest.approx(K * 0.2 * depth_m, rel=0.01)
    assert np.count_nonzero(np.diff(found) < 0.0) == pytest.approx(18e-3 / (0.2 * depth_m), abs=1)


def test_a_tool_that_is_pulled_sideways_trails_along_a_tractrix() -> None:
    """The held point follows at the length μ·depth: tan(φ/2) = tan(φ₀/2)·exp(−s/length), φ its angle to the way."""
    depth_m, friction = 0.01, 0.5
    length_m = friction * depth_m
    errors = []
    for steps in (200, 400):
        out = [(depth_m, 1e-5 * k, 0.0) for k in range(1000)]  # drags along y, until the held point trails straight
        aside = [(depth_m, out[-1][1], 0.01 * (k + 1) / steps) for k in range(steps)]
        y, z = forces(plane(friction=friction), out + aside)[-1, 1:] / K
        angle = 2.0 * math.atan(math.tan(math.pi / 4.0) * math.exp(-0.01 / length_m))
        errors.append(math.hypot(y - length_m * math.sin(angle), z - length_m * math.cos(angle)))
    assert errors[0] < 1e-4
    assert errors[1] < 0.6 * errors[0]  # in proportion to the step


def test_on_a_sphere_the_tangential_force_stays_on_the_cone_while_the_tool_slides() -> None:
    friction, depth_m = 0.3, 0.003
    angles = [1e-4 * k for k in range(8000)]
    path_m = [(0.1 - (0.1 - depth_m) * math.cos(angle), (0.1 - depth_m) * math.sin(angle), 0.0) for angle in angles]
    body = ball(friction=friction)
    found = forces(body, path_m)[4000:]
    held = np.array(path_m)[4000:] - found / K
    normal = (np.array(body.centre_m) - held) / 0.1
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0)  # it is on the surface
    along_n = np.sum(found * normal, axis=1)
    across_n = np.linalg.norm(found - along_n[:, np.newaxis] * normal, axis=1)
    assert across_n == pytest.approx(friction * along_n)


def test_a_large_sphere_feels_like_a_plane() -> None:
    rng = np.random.default_rng(1)
    path = rng.normal(0.0, 1e-4, (500, 3)).cumsum(axis=0) + np.array([0.003, 0.0, 0.0])
    path_m = [tuple(at) for at in path.tolist()]
    far = Sphere(name="far", centre_m=(10.0, 0.0, 0.0), radius_m=10.0, stiffness_n_per_m=K, friction=0.4)
    assert forces(far, path_m) == pytest.approx(forces(plane(friction=0.4), path_m), abs=5e-3)


def test_the_step_does_not_matter_for_a_straight_way_into_the_surface() -> None:
    start, stop = np.array([-0.002, 0.0, 0.0]), np.array([0.006, 0.003, 0.0])
    ends = []
    for steps in (1, 2, 7, 1000):
        path_m = [tuple((start + (stop - start) * k / steps).tolist()) for k in range(steps + 1)]
        ends.append(forces(plane(friction=0.3, static_friction=0.6), path_m)[-1])
    assert ends == [pytest.approx(ends[0], abs=1e-9)] * 4


def test_viscosity_slides_with_the_speed_and_never_holds_the_tool_back() -> None:
    body = plane(viscosity_n_s_per_m=2.0, sliding_viscosity_n_s_per_m=3.0)
    found = forces(body, [(0.002, 0.0, 0.0), (0.003, 1e-4, -2e-4), (0.001, 1e-4, -2e-4)])
    assert found[1] == pytest.approx([K * 0.003 + 2.0 * 1.0, 3.0 * 0.1, 3.0 * -0.2])
    assert found[2] == pytest.approx([0.0, 0.0, 0.0])  # K · 1 mm is less than 2 N·s/m · 2 m/s


# Energy ---------------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(
    path_m=st.lists(st.tuples(*[st.floats(-0.01, 0.01)] * 3), min_size=2, max_size=40),
    friction=st.sampled_from([0.0, 0.2, 1.0]),
    static=st.sampled_from([0.0, 1.5]),
)
def test_a_plane_never_gives_more_energy_than_it_stores(path_m: list[Vector], friction: float, static: float) -> None:
    """With the force at the end of each step, which an exact spring cannot exceed."""
    found = forces(plane(friction=friction, static_friction=static), path_m)
    work_j = np.cumsum(np.sum(found[1:] * np.diff(path_m, axis=0), axis=1))
    first_j = 0.5 * found[0] @ found[0] / K
    stored_j = 0.5 * np.sum(found[1:] ** 2, axis=1) / K
    assert (work_j - stored_j + first_j >= -1e-12).all()


# Hard inputs ----------------------------------------------------------------------------------------------

WALLS: tuple[AnyBody, ...] = (
    plane(stiffness_n_per_m=1e6, friction=0.5),
    plane(stiffness_n_per_m=1e6, friction=0.5, static_friction=9.0, viscosity_n_s_per_m=1e6),
    ball(stiffness_n_per_m=1e6, friction=0.5),
    ball(stiffness_n_per_m=1e6, friction=1e-9, sliding_viscosity_n_s_per_m=1e6),
)
jumps_m = st.lists(
    st.tuples(*[st.sampled_from([0.0, -0.0, 5e-324, 1e-9, -1e-9, 0.003, -0.003, 0.1, 1e15, -1e15])] * 3),
    min_size=1,
    max_size=30,
)


@pytest.mark.parametrize("wall", WALLS)
@settings(deadline=None)
@given(path_m=jumps_m, stamps_us=st.lists(st.integers(0, 3000), min_size=30, max_size=30))
def test_a_wall_of_1e6_n_per_m_survives_positions_that_jump_repeat_and_go_back_in_time(
    wall: AnyBody, path_m: list[Vector], stamps_us: list[int]
) -> None:
    scene = BodyScene([wall])
    for t_us, at in zip(stamps_us, path_m, strict=False):
        force_n = scene.step(PositionSample(t_us, at)).force_n
        assert math.hypot(*force_n) <= LARGEST_FORCE_N * (1.0 + 1e-9)
        outside = scene.depths_m()[0] <= 0.0
        assert (force_n == (0.0, 0.0, 0.0)) or not outside


@pytest.mark.parametrize("wall", [WALLS[0], WALLS[2]])
def test_a_tool_at_rest_feels_a_constant_force(wall: AnyBody) -> None:
    scene = BodyScene([wall])
    for k in range(50):
        scene.step(PositionSample(k, (0.001, 1e-5 * k, 0.0)))
    first = scene.step(PositionSample(100, (0.001, 5e-4, 0.0))).force_n
    assert {scene.step(PositionSample(t_us, (0.001, 5e-4, 0.0))).force_n for t_us in range(101, 2000)} == {first}


def test_a_tool_in_the_centre_of_a_sphere_keeps_the_point_it_holds() -> None:
    scene = BodyScene([ball(friction=0.3)])
    scene.step(PositionSample(0, (-0.01, 0.0, 0.0)))
    assert scene.step(PositionSample(1, (0.1, 0.0, 0.0))).force_n == pytest.approx((K * 0.1, 0.0, 0.0))
    assert BodyScene([ball()]).step(PositionSample(0, (0.1, 0.0, 0.0))).force_n == pytest.approx((K * 0.1, 0.0, 0.0))


@pytest.mark.parametrize("position_m", [(math.nan, 0.0, 0.0), (math.inf, 0.0, 0.0), (0.0,), (0.0, 0.0), ()])
def test_an_invalid_position_is_refused_and_changes_nothing(position_m: Vector) -> None:
    scene, twin = BodyScene(WALLS[2:3]), BodyScene(WALLS[2:3])
    for k in range(20):
        with pytest.raises(SampleError, match="position"):
            scene.step(PositionSample(500, position_m))
        at = PositionSample(k, (1e-4 * k - 5e-4, 2e-4 * k, 0.0))
        assert scene.step(at) == twin.step(at)


# Settings and views ---------------------------------------------------------------------------------------


def test_the_planes_announced_give_the_force_without_friction() -> None:
    scene = BodyScene([plane(inward=(0.9, 0.3, 0.1)), ball()])
    tool_m = (0.004, 0.001, -0.002)
    force_n = np.zeros(3)
    felt_n = scene.step(PositionSample(0, tool_m)).force_n
    for layer in scene.ahead():
        assert math.hypot(*layer.normal) == pytest.approx(1.0)
        force_n += layer.stiffness_n_per_m * max(0.0, layer.depth_m(tool_m)) * np.array(layer.normal)
    assert force_n == pytest.approx(felt_n)


def test_contacts_and_depths_are_told_for_each_body() -> None:
    scene = BodyScene([plane(), ball()])
    scene.step(PositionSample(0, (0.003, 0.05, 0.0)))
    assert scene.contacts() == (Contact.CONTACT, Contact.NONE)
    assert scene.depths_m()[0] == pytest.approx(0.003)
    scene.reset()
    assert scene.contacts() == (Contact.NONE, Contact.NONE)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plane(inward=(0.0, 0.0, 0.0)), "inward is .*must have a direction"),
        (lambda: plane(stiffness_n_per_m=2e6), "stiffness_n_per_m is 2000000.0"),
        (lambda: plane(friction=math.nan), "friction is nan"),
        (lambda: plane(friction=0.5, static_friction=0.4), "static_friction is 0.4; it must be 0 or between 0.5"),
        (lambda: ball(radius_m=0.0), "radius_m is 0.0"),
        (lambda: Plane(name="a", point_m=(0.0,), inward=(1.0, 0.0), stiffness_n_per_m=1.0), "must be 2 or 3 numbers"),
        (lambda: Plane(name="a", point_m=(0.0,) * 3, inward=(1.0, 0.0), stiffness_n_per_m=1.0), "as many"),
        (lambda: BodyScene([]), "no body"),
        (lambda: BodyScene([ball(), plane(axes=2)]), "'ball' has 3 axes and body 'plane' 2"),
        (lambda: BodyScene([ball(), ball()]), "2 bodies are called 'ball'"),
    ],
)
def test_settings_that_cannot_be_used_are_refused_with_the_value_seen(make, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(SettingsError, match=message):
        make()
