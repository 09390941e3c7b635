import math
import statistics
import time

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.errors import SampleError, SettingsError, UserCodeError
from hapticnet_mujoco import Pose, Task

BENCHES = ["workbench", "armbench"]
HANDLE_M, SQUEEZE_M = 0.014, 0.006


def bench(model="workbench", **options):
    return Pose(model, "palm", point="tip", grip="opening", **options)


def step(scene, milliseconds, *position):
    return scene.step(hn.PositionSample(1000 * milliseconds, position))


def play(scene, task):
    """Return the forces, and where drawer, screw and pad are, at every millisecond of a task."""
    hand = Task(task)
    joints = [scene._now.data.joint(name).qpos for name in ("rail", "turn", "cushion")]
    forces, places = [], []
    for t_us in range(0, hand.duration_us, 1000):
        forces.append(scene.step(hand.sample(t_us)))
        places.append([joint[0] for joint in joints])
    return np.array(forces), np.array(places)


def saved(tmp_path, text):
    file = tmp_path / "own.xml"
    file.write_text(f'<mujoco><option timestep="0.001"/>{text}</mujoco>')
    return str(file)


TOOL = '<body name="t" pos="0.1 0 0.2" euler="10 20 30"><geom type="box" size="0.03 0.02 0.01" mass="0.1"/></body>'


@pytest.mark.parametrize("frame", ["", "view"])
def test_the_tool_takes_the_pose_of_the_hand_in_the_axes_of_the_frame(tmp_path, frame):
    scene = Pose(saved(tmp_path, f'<worldbody><site name="view" euler="0 90 0"/>{TOOL}</worldbody>'), "t", frame=frame)
    assert scene.parts == ("force:3", "torque:3")
    began = scene._now.data.xpos[1].copy(), scene._now.data.xmat[1].reshape(3, 3).copy()
    to = (0.01, 0.02, 0.03, 0.3, -0.4, 1.2)
    for each in range(1000):
        force_n = step(scene, each, *(min(each / 500, 1.0) * x for x in to))
    assert force_n == pytest.approx((0.0,) * 6, abs=1e-4)
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) if frame else np.eye(3)
    assert scene._now.data.xpos[1] - began[0] == pytest.approx(axes @ to[:3], abs=1e-5)
    angle, about = math.hypot(*to[3:]), axes @ np.array(to[3:]) / math.hypot(*to[3:])
    cross = np.cross(np.eye(3), about)  # Rodrigues' formula
    turned = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    assert scene._now.data.xmat[1].reshape(3, 3) == pytest.approx(turned @ began[1], abs=1e-4)


def test_a_tool_of_a_mechanism_keeps_its_joint_and_a_spring_answers_its_closed_form(tmp_path):
    hinge = '<joint type="hinge" axis="0 0 1" stiffness="3" damping="0.01"/>'
    text = f'<worldbody><body name="t">{hinge}<geom type="box" size="0.03 0.02 0.01" mass="0.2"/></body></worldbody>'
    scene = Pose(saved(tmp_path, text), "t")
    assert scene._model.nv == 1
    for each in range(2000):
        force_n = step(scene, each, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1 * min(each / 500, 1.0))
    in_series = 0.1 / (1 / 2.0 + 1 / 3.0)  # coupling and spring
    assert force_n == pytest.approx((0.0, 0.0, 0.0, 0.0, 0.0, in_series), abs=1e-3)


def test_a_turn_may_exceed_one(tmp_path):
    scene = Pose(saved(tmp_path, f"<worldbody>{TOOL}</worldbody>"), "t")
    torques = [step(scene, each, 0.0, 0.0, 0.0, 0.0, 0.0, 0.004 * each)[5] for each in range(2000)]
    assert max(map(abs, torques[100:])) < 1e-3


@pytest.mark.parametrize("model", BENCHES)
def test_a_drawer_is_gripped_opened_to_its_stop_and_closed(model):
    forces, places = play(bench(model), "drawer")
    rail_m = places[:, 0]
    assert rail_m.max() == pytest.approx(0.1, abs=5e-4)
    assert rail_m[-1] < 0.003
    pulling = (rail_m > 0.02) & (rail_m < 0.08) & (np.arange(len(rail_m)) < 6000)
    # It pulls towards -y against friction of 1.5 N and 2 N·s/m at 80 mm/s
    assert np.median(forces[pulling, 1]) == pytest.approx(-1.5 - 2.0 * 0.08, rel=0.15)
    assert np.median(forces[pulling, 6]) == pytest.approx(-1000.0 * SQUEEZE_M, rel=0.1)  # soft pads


@pytest.mark.parametrize("model", BENCHES)
def test_a_screw_turns_against_its_friction_and_is_gripped_anew(model):
    forces, places = play(bench(model), "screw")
    turn = places[:, 1]
    assert turn[-1] == pytest.approx(3 * 1.6, rel=0.05)
    speed = np.gradient(turn, 1e-3)
    assert np.median(forces[speed > 0.8, 5]) == pytest.approx(0.04 + 0.002 * 1.5, rel=0.15)
    assert abs(turn[-1] - turn[-1500]) < 0.02  # nobody holds it


def test_a_pad_answers_its_closed_form():
    scene = bench()
    for each in range(3000):
        at_m = -0.085 - 0.032 * min(each / 2000, 1.0)
        force_n = step(scene, each, -0.15, 0.1, at_m, 0.0, 0.0, 0.0, 0.006)
    touch_m = -0.095
    # k d + a d³ = K (touch − at − d), with the pad pressed d deep
    deep_m = next(d for d in np.arange(0.0, 0.02, 1e-6) if 250.0 * d + 3e6 * d**3 >= 1000.0 * (touch_m - at_m - d))
    assert force_n[2] == pytest.approx(-1000.0 * (touch_m - at_m - deep_m), rel=0.05)
    assert force_n[6] == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("frame", ["", "view"])
def test_contacts_answer_force_and_torque_about_the_point_and_nothing_in_free_space(tmp_path, frame):
    floor = '<geom type="plane" size="1 1 0.1" pos="0 0 0.15"/><site name="view" euler="0 90 0"/>'
    tool = """<body name="t" pos="0 0 0.2"><geom type="capsule" fromto="0.1 0 0 0.1 0 -0.02" size="0.01" mass="0.1"/>
              <geom type="box" size="0.01 0.01 0.01" mass="0.2"/></body>"""
    scene = Pose(saved(tmp_path, f"<worldbody>{floor}{tool}</worldbody>"), "t", force="contact", frame=frame)
    assert step(scene, 0, *(0.0,) * 6) == (0.0,) * 6
    assert step(scene, 1, 0.001, *(0.0,) * 5) == (0.0,) * 6
    for each in range(2, 2000):
        down_m = -0.025 * min(each / 1000, 1.0)  # the tip meets the floor, 20 mm below it
        force = step(scene, each, *((-down_m, 0.0, 0.0) if frame else (0.0, 0.0, down_m)), 0.0, 0.0, 0.0)
    # It pushes 5 mm and the tool turns: the coupling's two springs in series at 0.1 m
    size_n = 0.005 / (1 / 1000.0 + 0.1**2 / 2.0)
    # Negative where the floor pushes towards larger values; the lever is 0.1 m along x
    expected = (size_n, 0.0, 0.0, 0.0, 0.1 * size_n, 0.0) if frame else (0.0, 0.0, -size_n, 0.0, 0.1 * size_n, 0.0)
    assert force == pytest.approx(expected, abs=0.1 * size_n)


@pytest.mark.parametrize("model", BENCHES)
def test_a_step_is_short_and_so_is_a_copy_that_looks_150_ms_ahead(model):
    scene, hand = bench(model), Task("screw")
    took = {"step": [], "ahead": []}
    for each in range(2500, 5000):
        sample = hand.sample(1000 * each)
        began = time.perf_counter()
        scene.step(sample)
        took["step"].append(time.perf_counter() - began)
        if each % 50 == 0:
            began = time.perf_counter()
            scene.copy().step(hn.PositionSample(1000 * (each + 150), sample.position_m))
            took["ahead"].append(time.perf_counter() - began)
    assert statistics.median(took["step"]) < 250e-6  # 30 to 50 µs on a quiet machine
    assert statistics.median(took["ahead"]) < 3e-3


def test_a_copy_goes_its_own_way_and_is_as_the_scene_would_be():
    scene, hand = bench(), Task("drawer")
    for each in range(2500):
        scene.step(hand.sample(1000 * each))
    copies = [scene.copy() for _ in range(2)]
    for each in range(2500, 2800):
        copies[0].step(hn.PositionSample(1000 * each, (0.05,) * 7))
    one = [copies[1].step(hand.sample(1000 * each)) for each in range(2500, 2600)]
    assert one == [scene.step(hand.sample(1000 * each)) for each in range(2500, 2600)]


@pytest.mark.parametrize("task", ["drawer", "screw", "pad"])
def test_a_copy_that_hurries_ends_where_the_scene_will_be(task):
    scene, hand = bench(), Task(task)
    errors_n = []
    for each in range(hand.duration_us // 1000 - 150):
        scene.step(hand.sample(1000 * each))
        if each % 200 == 100:
            ahead, truth = scene.copy(), scene.copy()
            hurried = ahead.step(hand.sample(1000 * (each + 150)))
            for later in range(each + 1, each + 151):
                true = truth.step(hand.sample(1000 * later))
            errors_n.append(np.abs(np.subtract(hurried, true)))
    assert np.median(errors_n, axis=0) == pytest.approx([0.0] * 7, abs=0.15)
    assert np.percentile(errors_n, 90, axis=0)[6] < 0.1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"point": "tipp"}, "the tool 'palm' has no site 'tipp'; it has: tip"),
        ({"grip": "close"}, "has no joint or tendon 'close' as grip; it has: opening, rail, depth"),
        ({"tool": "plam"}, "no body 'plam' as tool"),
        ({"frame": "here"}, "a site that is fixed to the world"),
        ({"turning_stiffness": 1e4}, "too light for a coupling of 10000 N·m/rad"),
        ({"stiffness": -1.0}, "stiffness is -1"),
        ({"force": "both"}, "force is 'both'; it must be coupling or contact"),
        ({"key": "home"}, "has no keyframe 'home'"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_sentence(given, said):
    with pytest.raises(SettingsError, match=said) as refused:
        Pose(**{"model": "workbench", "tool": "palm", "point": "tip", "grip": "opening"} | given)
    assert "\n" not in str(refused.value)


def test_a_free_tool_inside_another_body_is_refused_in_one_sentence(tmp_path):
    with pytest.raises(SettingsError, match="free joint") as refused:
        Pose(saved(tmp_path, f'<worldbody><body name="base">{TOOL}</body></worldbody>'), "t")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("position", [(math.nan,) * 7, (0.0,) * 6, (1e9,) + (0.0,) * 6, (math.inf,) * 7])
def test_a_position_that_is_none_is_refused_and_changes_nothing(position):
    scene = bench()
    with pytest.raises(SampleError):
        step(scene, 0, *position)
    assert scene._begin_us is None


def test_physics_that_fails_is_one_sentence_and_begins_again_at_rest(tmp_path):
    runs_away = '<body pos="0 0 1"><joint type="slide" damping="-1000"/><geom size="0.01"/></body>'
    scene = Pose(saved(tmp_path, f"<worldbody>{TOOL}{runs_away}</worldbody>"), "t")
    for _ in range(2):
        with pytest.raises(UserCodeError, match="physics has failed and begins again at rest: ") as failed:
            [step(scene, each, *(0.01,) * 6) for each in range(3000)]
        assert "\n" not in str(failed.value)
        assert np.isfinite(scene._now.data.qpos).all()


def test_a_task_depends_on_time_and_seed_only_and_never_jumps():
    one, same, other = Task("drawer+pad"), Task("drawer+pad"), Task("drawer+pad", seed=1)
    times_us = range(0, one.duration_us + 2000, 1000)
    positions = np.array([one.sample(t_us).position_m for t_us in times_us])
    assert positions.tolist() == [list(same.sample(t_us).position_m) for t_us in reversed(times_us)][::-1]
    assert other.sample(5_000_000) != one.sample(5_000_000)
    assert np.abs(np.diff(positions[1:-2], axis=0)).max() < 0.005
    steady = np.array([Task("pad", tremor_m=0.0).sample(t_us).position_m for t_us in (0, 1_200_000)])
    assert steady[1].tolist() == pytest.approx([-0.15, 0.1, -0.055, 0.0, 0.0, 0.0, 0.006], abs=1e-9)
    with pytest.raises(SettingsError, match="task is 'door'; it must be some of drawer, screw, pad"):
        Task("door")


def test_a_bench_says_how_it_looks():
    view, *shapes = bench().shapes()
    assert view.kind == "view"
    assert {each.kind for each in shapes} <= {"plane", "sphere", "capsule", "box"}
    assert len(shapes) > 5
