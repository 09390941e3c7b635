import itertools
import math
import re
import time
from pathlib import Path

import pytest
from dds_peers import CALM, HERE, POSE, WRENCH, Behind, now, pose, reader, robot_behind, settle, step, wrench, writer

from hapticnet.errors import SettingsError
from hapticnet_ros2 import Leader, Robot
from hapticnet_ros2.messages import Header, Point, Pose, PoseStamped, Quaternion, TransformStamped, Vector3
from hapticnet_ros2.topics import BEST_EFFORT, RELIABLE


def test_topics_have_the_names_that_ros_gives_them(space, made):
    robot = made(Robot(space, **CALM))
    assert robot._sent._writer.topic.name == f"rt{space}/servo_cp"
    assert robot._sent._writer.topic.typename == "geometry_msgs::msg::dds_::PoseStamped_"
    assert robot._force._topic.typename == "geometry_msgs::msg::dds_::WrenchStamped_"


def test_a_robot_starts_where_it_is_and_moves_along_the_axes_named(space, made):
    with robot_behind(space) as behind:
        robot = made(Robot(space, "-zx", scale=2.0, orientation="0/0.6/0/0.8", **CALM))
        settle(robot, 0.5, 0.5)
        assert behind.newest.pose.position == Point(0.1, 0.1, 0.1)
        force_n = settle(robot, 0.505, 0.49)
        at = behind.newest.pose
        assert (at.position.x, at.position.y, at.position.z) == pytest.approx((0.08, 0.1, 0.09))
        assert at.orientation == Quaternion(0.0, 0.6, 0.0, 0.8)  # unchanged
        assert force_n == pytest.approx((4.0, -8.0))  # a spring: positive where the coordinate is


def test_without_options_the_orientation_is_the_robots_own(space, made):
    turn = Quaternion(0.0, 0.0, 1.0, 0.0)
    with robot_behind(space, lambda _: (PoseStamped(Header(now()), Pose(Point(), turn)), wrench())) as behind:
        settle(made(Robot(space, 3, **CALM)), 0.0, 0.0, 0.0)
        assert behind.newest.pose.orientation == turn


def test_positions_can_be_transforms_as_in_older_robots(space, made):
    qos = BEST_EFFORT
    with Behind(lambda _: (), [], reader(f"{space}/servo_cp", TransformStamped, qos)) as behind:
        place = {"home": "1/2/3", "orientation": "0/0/0/1"}
        settle(made(Robot(space, "y", message="TransformStamped", **place, **CALM)), 0.0)
        assert behind.newest.transform.translation == Vector3(1.0, 2.0, 3.0)
        assert behind.newest.child_frame_id == ""


def test_a_leap_of_the_hand_is_made_at_the_largest_speed(space, made):
    with robot_behind(space) as behind:
        robot = made(Robot(space, "z", speed=0.1, **CALM))
        settle(robot, 0.0)
        settle(robot, 1.0, seconds=0.2)
        assert 0.1 < behind.newest.pose.position.z < 0.1 + 0.1 * 0.3


def test_subscribers_that_ask_for_reliability_hear_it_too(space, made):
    with robot_behind(space, qos=RELIABLE) as behind:
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (0.0,)
        assert settle(robot, 0.01) == pytest.approx((4.0,))
        assert behind.newest is not None
        assert robot._sent.dropped == 0


def test_a_robot_that_stops_is_one_line_and_no_force(space, made, caplog):
    with robot_behind(space) as behind:
        robot = made(Robot(space, "z", **CALM))
        settle(robot, 0.0)
        assert settle(robot, 0.01) == pytest.approx((4.0,))
        behind.is_talking = False
        stopped_s = time.monotonic()
        forces_n = []
        while time.monotonic() < stopped_s + 0.6:
            forces_n.append((time.monotonic() - stopped_s, step(robot, 0.01)[0]))
            time.sleep(0.001)
        assert all(force_n == 0.0 for at_s, force_n in forces_n if at_s > 0.45)
        assert all(after <= before for (_, before), (_, after) in itertools.pairwise(forces_n))
        assert [line for line in caplog.messages if "measured_cf" in line] == [
            f"no WrenchStamped on {space}/measured_cf for 200 ms; the force is zero"
        ]
        behind.is_talking = True
        assert settle(robot, 0.01) == pytest.approx((4.0,))
        assert f"WrenchStamped on {space}/measured_cf arrives again" in caplog.messages


def test_a_message_that_is_repeated_is_not_new(space, made, caplog):
    stamps = [None]
    with robot_behind(space, lambda _: (pose(), wrench(z=-4.0, stamp=stamps[0]))):
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (4.0,)
        stamps[0] = now()
        assert settle(robot, 0.0, seconds=0.6) == (0.0,)
        assert f"no WrenchStamped on {space}/measured_cf for 200 ms; the force is zero" in caplog.messages


def test_the_age_of_a_message_counts_from_its_arrival_even_if_positions_come_rarely(space, made):
    with robot_behind(space, lambda _: (pose(), wrench(z=-4.0))) as behind:
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (4.0,)
        for _ in range(3):
            time.sleep(0.5)
            assert step(robot, 0.0) == (4.0,)  # as fresh as if asked all the time
        time.sleep(0.05)
        behind.is_talking = False
        time.sleep(0.6)
        assert step(robot, 0.0) == (0.0,)  # what waits there is 0.6 s old


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 1e9])
def test_a_force_that_is_none_is_one_line_and_no_force(space, made, caplog, wrong):
    felt_n = [-4.0]
    with robot_behind(space, lambda _: (pose(), wrench(z=felt_n[0]))):
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.0) == (4.0,)
        felt_n[0] = wrong
        assert settle(robot, 0.0, seconds=0.3) == (0.0,)
        assert [line for line in caplog.messages if "measured_cf" in line] == [
            f"WrenchStamped on {space}/measured_cf has a value that is NaN or too large; the force is zero"
        ]
        felt_n[0] = -2.0
        assert settle(robot, 0.0) == (2.0,)


def test_it_is_said_who_is_missing_or_of_another_kind(space, made, caplog):
    with Behind(lambda _: (pose(),), [writer(f"{space}/measured_cf", PoseStamped)]):
        robot = made(Robot(space, "z", **CALM))
        assert settle(robot, 0.01, seconds=1.3) == (0.0,)
    assert sorted(each for each in caplog.messages if space in each) == [
        f"PoseStamped on {space}/servo_cp is not heard: nobody subscribes",
        f"no PoseStamped on {space}/measured_cp: nobody publishes it; the force is zero",
        f"no WrenchStamped on {space}/measured_cf: it carries {POSE}, not {WRENCH}; the force is zero",
    ]


def test_a_subscriber_that_cannot_hear_best_effort_is_said(space, made, caplog):
    with robot_behind(space, qos=RELIABLE) as behind:
        settle(made(Robot(space, "z", reliable=False, **CALM)), 0.0, seconds=1.2)
        assert behind.newest is None
    assert any("servo_cp is not heard: its subscriber asks for reliable messages" in each for each in caplog.messages)


def test_the_newest_master_moves_the_robot_and_the_other_feels_nothing(space, made, caplog):
    with robot_behind(space, lambda _: (pose(), wrench(z=-4.0))):
        first, second = (made(Robot(space, "z", **CALM)) for _ in range(2))
        first.welcome("a")
        assert settle(first, 0.0) == (4.0,)
        assert settle(second, 0.0, seconds=0.05) == (0.0,)
        second.welcome("b")
        assert settle(first, 0.0, seconds=0.05) == (0.0,)
        assert settle(second, 0.0) == (4.0,)
    assert f"ros2:{space} is moved by another master; the force is zero" in caplog.messages


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"axes": 4}, "axes is '4'; it must be 1, 2, 3, or"),
        ({"axes": "xx"}, "axes is 'xx'"),
        ({"namespace": "/PSM 1"}, "cannot be the name of a topic"),
        ({"domain": 300}, "domain is 300"),
        ({"interface": "eth99"}, "already uses interface 'lo'"),
        ({"domain": 89, "interface": "eth99"}, "DDS cannot be used in domain 89 on interface 'eth99'"),
        ({"message": "Pose"}, "must be PoseStamped or TransformStamped"),
        ({"scale": 0.0}, "scale is 0.0"),
        ({"fresh_ms": 0.0}, "fresh_ms is 0.0"),
    ],
)
@pytest.mark.parametrize("made_of", [Robot, Leader])
def test_what_cannot_be_used_is_said_in_one_sentence(made_of, given, said):
    with pytest.raises(SettingsError, match=said) as refused:
        made_of(**HERE | given)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("given", [{"home": "1/2"}, {"home": "1/2/nan"}, {"orientation": "1/1/1/1"}, {"speed": 0.0}])
def test_options_of_a_robot_are_checked(given):
    with pytest.raises(SettingsError):
        Robot(**HERE | given)


def test_ros_domain_id_is_the_default(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "here")
    with pytest.raises(SettingsError, match="ROS_DOMAIN_ID is 'here'"):
        Leader()


def test_the_robot_of_the_page_runs(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<General><Interfaces><NetworkInterface name='lo'/></Interfaces></General>")
    (example,) = re.findall(r"```python\n(.*?)```", (Path(__file__).parents[1] / "README.md").read_text(), re.DOTALL)
    assert "while True:" in example
    exec(compile(example.replace("while True:", "for _ in range(10):"), "README.md", "exec"), {})  # noqa: S102 - our own
