import math
import re
import statistics
import time
from pathlib import Path

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.errors import SampleError, SettingsError, UnavailableError, UserCodeError
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.operator.yielding import HANDS, YieldingOperator
from hapticnet.scene.shapes import ShapeFeed, unpack_shapes
from hapticnet_mujoco import Scene

COUPLING = 1000.0  # N/m, the default
EVERY = [("block", "tip", "-z"), ("drawer", "finger", "yxz"), ("ball", "finger", "-zxy"), ("arm", "probe", "xyz")]


def at(milliseconds, *position_m):
    return hn.PositionSample(1000 * milliseconds, position_m)


def play(scene, positions_m, first=0):
    return np.array([scene.step(at(first + each, *position)) for each, position in enumerate(positions_m)])


def slowly(to_m, milliseconds=1000):
    return [(to_m * min(1.25 * each / milliseconds, 1.0),) for each in range(milliseconds)]


def saved(tmp_path, text):
    file = tmp_path / "own.xml"
    file.write_text(f"<mujoco>{text}</mujoco>")
    return str(file)


@pytest.mark.parametrize("force", ["coupling", "contact"])
@pytest.mark.parametrize("stiffness", [500.0, 1000.0, 5000.0])
@pytest.mark.parametrize("depth_m", [0.002, 0.005, 0.015])
def test_a_spring_answers_its_closed_form(force, stiffness, depth_m):
    scene = Scene("block", "tip", force=force, stiffness=stiffness)
    felt_n = play(scene, slowly(0.01 + depth_m))[-1, 0]
    # The spring of the plate and the coupling in series
    assert felt_n == pytest.approx(depth_m / (1 / 300 + 1 / stiffness), rel=0.02)


def test_a_rigid_table_is_as_stiff_as_the_coupling_and_pulls_nobody():
    scene = Scene("ball", "finger", "-zxy")
    forces_n = play(scene, [(0.045 + z, 0.1, 0.0) for (z,) in slowly(0.008)])
    assert forces_n[-1] == pytest.approx([COUPLING * 0.003, 0.0, 0.0], abs=0.01 * COUPLING * 0.003)
    assert play(scene, [(0.02, 0.1, 0.0)] * 500, 1000)[-1] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_sliding_on_a_table_meets_the_friction_of_coulomb():
    scene = Scene("ball", "finger", "-zxy")
    play(scene, [(0.045 + z, 0.1, 0.0) for (z,) in slowly(0.008)])
    normal_n, along_n, _ = play(scene, [(0.053, 0.1 + 2e-5 * each, 0.0) for each in range(1000)], 1000)[-1]
    assert along_n == pytest.approx(0.6 * normal_n, rel=0.02)


def test_a_drawer_moves_only_above_its_friction():
    scene = Scene("drawer", "finger", "y")
    rail = scene._model.joint("rail").qposadr[0]
    first_n = play(scene, slowly(0.0071))[-1, 0]  # the bar is 6 mm away: 1.1 N
    assert 0.9 < first_n < 1.2
    assert abs(scene._now.data.qpos[rail]) < 1e-3
    moving_n = play(scene, [(0.0071 + 2e-5 * each,) for each in range(2000)], 1000)[-500:, 0]
    assert statistics.mean(moving_n) == pytest.approx(1.5 + 1.0 * 0.02, rel=0.02)
    assert scene._now.data.qpos[rail] == pytest.approx(0.0395, abs=1e-3)


def test_an_arm_follows_the_hand_and_feels_the_wall():
    scene = Scene("arm", "probe", "xyz")
    assert np.abs(play(scene, [(0.0, 2e-5 * each, 0.0) for each in range(1000)])[-300:]).max() < 0.5
    tool_m = scene._now.data.actuator_length
    assert tool_m == pytest.approx([0.0, 0.02, 0.0], abs=1e-3)
    # The wall is 20 mm from the tool's surface
    felt_n = play(scene, [(0.023 * min(each / 1000, 1.0), 0.02, 0.0) for each in range(1500)], 1000)[-1]
    assert felt_n[0] == pytest.approx(COUPLING * 0.003, rel=0.05)


@pytest.mark.parametrize(("model", "tool", "axes"), EVERY)
def test_a_step_is_short_and_a_copy_takes_microseconds(model, tool, axes):
    scene = Scene(model, tool, axes)
    took = {"step": [], "copy": []}
    for each in range(2000):
        began = time.perf_counter()
        scene.step(at(each, *[1e-6 * each] * scene.axes))
        took["step"].append(time.perf_counter() - began)
        began = time.perf_counter()
        scene.copy()
        took["copy"].append(time.perf_counter() - began)
    assert statistics.median(took["step"]) < 200e-6  # 7 to 11 µs on a quiet machine
    assert statistics.median(took["copy"]) < 100e-6  # 5 to 6 µs


@pytest.mark.parametrize(("model", "tool", "axes"), EVERY)
def test_a_copy_goes_its_own_way_and_is_as_the_scene_would_be(model, tool, axes):
    scene = Scene(model, tool, axes)
    positions_m = [(1e-4 * each,) * scene.axes for each in range(300)]
    play(scene, positions_m)
    copies = [scene.copy() for _ in range(3)]
    assert len({id(each._now.data) for each in (scene, *copies)}) == 4
    play(copies[0], [(0.0,) * scene.axes] * 100, 300)
    one = [copies[1].step(at(300 + each, *positions_m[-1])) for each in range(50)]
    assert one == [copies[2].copy().step(at(300, *positions_m[-1])), *one[1:]]
    assert one == [scene.step(at(300 + each, *positions_m[-1])) for each in range(50)]
    used = id(copies[0]._now.data)
    del copies[0]
    assert id(scene.copy()._now.data) == used  # no new data for each copy


@pytest.mark.parametrize("step_ms", [0.25, 0.7, 1.0, 2.0])
def test_physics_makes_as_many_steps_as_fit_and_forgets_pauses(tmp_path, step_ms):
    file = saved(
        tmp_path,
        f'<option timestep="{1e-3 * step_ms}"/><worldbody><body name="t"><geom size="0.01"/></body></worldbody>',
    )
    scene = Scene(file, "t")
    scene.step(hn.PositionSample(12_345, (0.0,)))
    begun_s = scene._now.data.time
    for t_us in range(12_345, 1_012_346, 1000):
        scene.step(hn.PositionSample(t_us, (0.001,)))
    steps = math.floor(1000 / step_ms)
    assert scene._now.data.time - begun_s == pytest.approx(1e-3 * step_ms * steps, abs=1e-9)
    scene.step(hn.PositionSample(12_345 + 61_000_000, (0.001,)))
    assert scene._now.data.time - begun_s == pytest.approx(1.1, abs=3e-3)
    force_n = scene.step(hn.PositionSample(12_345 + 61_000_000, (5.0,)))  # no time has passed
    assert force_n == scene.step(hn.PositionSample(0, (5.0,)))


def test_axes_frame_and_scales_are_those_that_are_named(tmp_path):
    file = saved(
        tmp_path,
        """<worldbody><site name="view" pos="0.1 0 0" euler="0 90 0"/>
        <body name="t" mocap="true" pos="0.1 0 0" euler="30 40 50"><geom size="0.01"/></body></worldbody>""",
    )
    for axes, frame, moved_m in (
        ("-zx", "", (0.04, 0.0, -0.02)),
        ("z", "view", (0.02, 0.0, 0.0)),
        ("x", "view", (0.0, 0.0, -0.02)),
    ):
        scene = Scene(file, "t", axes, frame=frame, scale=2.0)
        play(scene, [tuple(0.01 * (axis + 1) for axis in range(scene.axes))] * 500)
        assert scene._now.data.xpos[1] - [0.1, 0, 0] == pytest.approx(moved_m, abs=1e-6)
    one, half = (Scene("block", "tip", force_scale=scale) for scale in (1.0, 0.5))
    assert play(half, slowly(0.02))[-1] == pytest.approx(0.5 * play(one, slowly(0.02))[-1])


def test_a_keyframe_is_where_it_begins_and_other_actuators_are_left_alone(tmp_path):
    file = saved(
        tmp_path,
        """<worldbody><body name="t" pos="0 0 0.5"><freejoint/><geom size="0.01"/></body>
        <body><joint name="j" type="slide" damping="1"/><geom size="0.01"/></body>
        <body name="m" mocap="true" pos="0 0 0.5"/></worldbody>
        <equality><weld body1="m" body2="t"/></equality>
        <actuator><position joint="j" kp="10"/></actuator>
        <keyframe><key name="home" qpos="0 0 0.5 1 0 0 0 0.25" ctrl="0.25"/></keyframe>""",
    )
    scene = Scene(file, "t", "xyz", key="home")
    play(scene, [(0.01, 0.02, 0.03)] * 500)
    joint = scene._model.joint("j").qposadr[0]
    assert scene._now.data.ctrl[0] == 0.25
    assert scene._now.data.qpos[joint] > 0.2
    assert scene._now.data.xpos[1] == pytest.approx([0.01, 0.02, 0.53], abs=1e-4)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"model": "none.xml"}, "no such file"),
        ({"tool": "tipp"}, "no body 'tipp' as tool; it has: plate, tip"),
        ({"tool": "world"}, "no body 'world'"),
        ({"axes": "q"}, "one to three of x, y, z"),
        ({"axes": "z-z"}, "one to three of x, y, z"),
        ({"frame": "here"}, "a site that is fixed to the world"),
        ({"key": "home"}, "has no keyframe 'home'; it has: none"),
        ({"force": "both"}, "coupling or contact"),
        ({"stiffness": "much"}, "must be a number"),
        ({"stiffness": 1e6}, "too light for a coupling"),
        ({"scale": 0.0}, "scale is 0.0"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_sentence(given, said):
    with pytest.raises(SettingsError, match=said) as refused:
        Scene(**{"model": "block", "tool": "tip"} | given)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["<worldbody><body name='t'><geom size='-1'/></body></worldbody>", "<worldb", "<o/>"])
def test_a_model_that_mujoco_refuses_is_one_sentence(tmp_path, text):
    with pytest.raises(SettingsError, match=r"model .*own.xml: ") as refused:
        Scene(saved(tmp_path, text), "t")
    assert "\n" not in str(refused.value)


def unstable(tmp_path):
    return saved(
        tmp_path,
        """<option timestep="0.01"/><worldbody><body name="t"><geom size="0.01"/></body>
        <body pos="0 0 1"><joint type="slide" damping="-1000"/><geom size="0.01"/></body></worldbody>""",
    )


def test_physics_that_fails_is_an_error_and_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = Scene(unstable(tmp_path), "t", stiffness=30.0)
    with pytest.raises(UserCodeError, match="physics has failed and begins again at rest: "):
        play(scene, [(0.0,)] * 100)
    assert [each.name for each in tmp_path.iterdir()] == ["own.xml"]


def test_physics_that_fails_ends_the_session_without_force(tmp_path):
    link = hn.virtual_link(scene=Scene(unstable(tmp_path), "t", stiffness=30.0), operator=hand())
    with pytest.raises(UnavailableError, match="the scene failed: mujoco:own: physics has failed"):
        link.run(seconds=2.0)
    assert not link.master_samples()["held_n"].any()


def test_a_position_that_is_none_is_refused():
    scene = Scene("block", "tip")
    for position_m in ((math.nan,), (0.0, 0.0)):
        with pytest.raises(SampleError):
            scene.step(hn.PositionSample(0, position_m))


def hand(of=None):
    pushed = ScriptedOperator(InsertionSettings(approach_m=0.006, depth_m=0.022), np.random.default_rng(1))
    return pushed if of is None else YieldingOperator(pushed, HANDS[of])


def felt(of=None, **settings):
    link = hn.virtual_link(
        scene="hapticnet_mujoco:Scene:model=block,tool=tip",
        operator=hand(of),
        forward="delay=50ms",
        feedback="delay=50ms",
        **settings,
    )
    link.run(seconds=6.0)
    return link.report()


def test_over_100_ms_what_follows_the_hand_is_felt_better():
    deadband, following = felt(codec="deadband"), felt(codec="motion-predictive")
    predicted = felt(codec="motion-predictive", predicted=True)
    assert deadband.felt_rmse_n > 1.5 * following.felt_rmse_n > 1.5 * predicted.felt_rmse_n
    assert predicted.felt_max_error_n < 0.5
    assert predicted.slave["predicted"]["fault"] is None


def test_a_hand_that_yields_swings_over_100_ms_unless_it_is_coupled_or_the_force_follows_it():
    swings = felt("arm", codec="deadband")
    coupled = felt("arm", codec="deadband", coupling="energy-bounded")
    following = felt("arm", codec="motion-predictive")
    assert swings.felt_rmse_n > 0.5
    assert coupled.felt_rmse_n < 0.3
    assert following.felt_rmse_n < 0.1


def test_the_force_of_the_coupling_does_not_jump_as_contacts_of_rigid_things_do():
    jumps_n = {}
    for force in ("coupling", "contact"):
        scene = Scene("ball", "finger", "-zxy", force=force)
        taps = [(0.05 + 0.003 * math.sin(0.02 * each), 0.1, 0.0) for each in range(2000)]
        jumps_n[force] = np.abs(np.diff(play(scene, taps)[400:, 0])).max()
    assert 2.0 * jumps_n["coupling"] < jumps_n["contact"]


def test_the_example_of_the_page_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", (Path(__file__).parents[1] / "README.md").read_text(), re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102 - our own page
    assert "mujoco:block" in capsys.readouterr().out


def test_a_model_says_how_it_looks_in_the_axes_of_the_hand():
    scene = Scene("ball", "finger", "-zxy", scale=2.0)
    play(scene, [(0.0, 0.0, 0.0)] * 10)
    view, *boxes, ball, tool = scene.shapes()
    assert (view.along, view.across, view.size_m) == ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert [each.kind for each in boxes] == ["box"] * 5
    assert tool.kind == "sphere"
    assert tool.at_m == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    assert tool.size_m == [0.005]  # 10 mm of the model are 5 mm of the hand
    assert boxes[0].at_m == pytest.approx([0.035, 0.0, 0.0])  # the table, 70 mm below the tool
    assert boxes[0].size_m == pytest.approx([0.005, 0.1, 0.1])
    assert boxes[0] is scene.shapes()[1], "what is fixed is described once"
    play(scene, [(0.02, 0.01 + 1e-5 * each, 0.0) for each in range(1000)], 10)
    assert scene.shapes()[-2].at_m[1] > ball.at_m[1] + 0.001, "the ball was pushed aside"


@pytest.mark.parametrize(("model", "tool", "axes"), EVERY)
def test_every_model_of_the_package_can_be_drawn(model, tool, axes):
    scene = Scene(model, tool, axes)
    count, found = unpack_shapes(ShapeFeed(scene.shapes).due(0))
    assert count == len(found) == len(scene.shapes())
    for shape in found.values():
        assert np.dot(shape.along, shape.across) == pytest.approx(0.0, abs=2e-3)
        assert math.hypot(*shape.along) == pytest.approx(1.0, abs=2e-3)


def test_meshes_are_drawn_as_boxes_and_planes_as_solid_below(tmp_path):
    geoms = '<geom type="plane" size="1 1 .1"/><geom type="ellipsoid" size=".01 .02 .03"/><geom group="4" size=".1"/>'
    file = saved(tmp_path, f'<worldbody>{geoms}<body name="t" pos="0 0 .1"><geom size=".01"/></body></worldbody>')
    _, plane, ellipsoid, tool = Scene(file, "t", "-z").shapes()
    assert (plane.kind, plane.along) == ("plane", [1.0, 0.0, 0.0])  # down, as the hand pushes
    assert (ellipsoid.kind, tool.kind) == ("box", "sphere")
    assert ellipsoid.size_m == pytest.approx([0.03, 0.01, 0.02])
