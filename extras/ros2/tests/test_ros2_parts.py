import math
import time

import pytest
from dds_peers import (
    CALM,
    HERE,
    RELIABLE,
    Behind,
    hold,
    joint,
    leader_behind,
    pose,
    reader,
    settle,
    wrench,
    writer,
)

import hapticnet as hn
from hapticnet.errors import SettingsError
from hapticnet.rotations import inverse, normalised, product, quaternion_of, rotated, vector_near
from hapticnet_ros2 import Leader, Robot
from hapticnet_ros2.frames import Frame
from hapticnet_ros2.messages import JointState, PoseStamped, WrenchStamped

ALL = {"parts": "force+torque+grip"} | CALM
HOME = normalised((0.1, -0.2, 0.3, 0.9))


def close(values):
    return pytest.approx(values, abs=1e-6)


def arm_behind(space, felt=lambda: wrench(), jaw=lambda: joint(0.03, 0.0)):
    outputs = [
        writer(f"{space}/measured_cp", PoseStamped),
        writer(f"{space}/measured_cf", WrenchStamped),
        writer(f"{space}/jaw/measured_js", JointState),
    ]
    heard = reader(f"{space}/servo_cp", PoseStamped)
    return Behind(lambda _: (pose(0.1, 0.1, 0.1, turn=HOME), felt(), jaw()), outputs, heard)


def last_of(topic_reader):
    found = topic_reader.take(1)
    return found[0] if found and found[0].sample_info.valid_data else None


def turn_of(message):
    return message.values()[3:]


# The axes


@pytest.mark.parametrize("axes", ["xyz", "-zxy", "yxz", "-x-yz"])  # with and without a mirror
def test_a_turned_vector_seen_along_other_axes_is_the_seen_vector_turned(axes):
    frame, turn, vector = Frame(axes, "force+torque", "base"), quaternion_of((0.3, -0.5, 0.9)), (1.0, 2.0, 3.0)
    seen = (*frame.turn_seen(turn[:3]), turn[3])
    assert frame.seen(rotated(vector, turn)) == close(rotated(frame.seen(vector), seen))
    assert frame.shown(frame.seen(vector)) == vector
    assert frame.turn_shown(frame.turn_seen(vector)) == vector


# The robot


def test_a_robot_turns_from_where_it_is_and_its_torque_and_grip_are_felt(space, made):
    jaw_told = reader(f"{space}/jaw/servo_jp", JointState)
    with arm_behind(space, lambda: wrench(1.0, 2.0, 3.0, torque=(0.1, 0.2, 0.3)), lambda: joint(0.6, -0.04)) as behind:
        robot = made(Robot(space, 3, jaw_m=0.02, turn_speed=20.0, **ALL))
        assert robot.parts == ("force:3", "torque:3", "grip:1")
        assert robot.frame == f"+x, +y, +z of {space}"
        begun = (0.5, 0.5, 0.5, 0.0, 0.4, 0.0, 0.012)
        assert settle(robot, *begun) == pytest.approx((-1.0, -2.0, -3.0, -0.1, -0.2, -0.3, -2.0))
        assert turn_of(behind.newest) == close(HOME)
        assert last_of(jaw_told).position == close([0.6])
        settle(robot, 0.5, 0.5, 0.51, 0.0, 0.4, 0.8, 0.010)
        away = product(quaternion_of((0.0, 0.4, 0.8)), inverse(quaternion_of((0.0, 0.4, 0.0))))
        assert behind.newest.values() == close((0.1, 0.1, 0.11, *product(away, HOME)))
        assert last_of(jaw_told).position == close([0.5])


def test_a_leap_of_orientation_and_opening_is_made_slowly(space, made):
    jaw_told = reader(f"{space}/jaw/servo_jp", JointState)
    with arm_behind(space) as behind:
        robot = made(Robot(space, 3, turn_speed=0.5, **ALL))
        settle(robot, *(0.0,) * 7)  # the hand is closed and the jaw 30 mm open
        assert 0.01 < last_of(jaw_told).position[0] <= 0.03  # at 50 mm/s
        settle(robot, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, seconds=1.0)
        away = vector_near(product(turn_of(behind.newest), inverse(HOME)), (0.0,) * 3)
        assert 0.2 < away[0] < 0.6
        assert last_of(jaw_told).position == close([0.0])


def test_a_wrench_along_the_axes_of_the_tool_turns_with_it(space, made):
    quarter = (math.pi / 2.0, 0.0, 0.0)
    with arm_behind(space, lambda: wrench(z=2.0, torque=(0.0, 0.3, 0.0))):
        robot = made(Robot(space, 3, parts="force+torque", orientation="0/0/0/1", wrench_axes="tool", **CALM))
        assert settle(robot, *(0.0,) * 6) == close((0.0, 0.0, -2.0, 0.0, -0.3, 0.0))
        felt = settle(robot, 0.0, 0.0, 0.0, *quarter, seconds=1.2)
        assert felt == close((0.0, 2.0, 0.0, 0.0, 0.0, -0.3))


@pytest.mark.parametrize("fault", ["silent", "no effort", "two joints"])
def test_a_jaw_without_effort_is_one_line_and_no_grip_and_the_force_stays(space, made, caplog, fault):
    told = [joint(0.03, -2.0)]

    def jaw():
        if told[0] is not None:
            told[0].header.stamp = joint(0.0).header.stamp
        return told[0]

    with arm_behind(space, lambda: wrench(x=-1.0), jaw):
        robot = made(Robot(space, 3, parts="force+grip", **CALM))
        assert settle(robot, 0.0, 0.0, 0.0, 0.0) == (1.0, 0.0, 0.0, -2.0)
        told[0] = {"silent": None, "no effort": joint(0.03), "two joints": joint(0.03, 1.0)}[fault]
        if fault == "two joints":
            told[0].effort = [1.0, 2.0]
        assert settle(robot, 0.0, 0.0, 0.0, 0.0, seconds=0.6) == (1.0, 0.0, 0.0, 0.0)
        why = f"no JointState on {space}/jaw/measured_js for 200 ms"
        if fault != "silent":
            why = f"JointState on {space}/jaw/measured_js must have one position and one effort, both numbers"
        assert [each for each in caplog.messages if "measured_js" in each] == [f"{why}; the force is zero"]
        told[0] = joint(0.03, -2.0)
        assert settle(robot, 0.0, 0.0, 0.0, 0.0) == (1.0, 0.0, 0.0, -2.0)


# The leader


class Hand:
    """A device with a jaw of 40 mm, an angle in rad, and what it was told."""

    def __init__(self, space):
        self.at, self.turn, self.angle = [0.3, 0.2, 0.1], HOME, 0.5
        self.drive = reader(f"{space}/jaw/servo_jf", JointState, RELIABLE)
        self.behind = leader_behind(space, lambda _: (pose(*self.at, turn=self.turn), joint(self.angle)))
        self.behind.outputs.append(writer(f"{space}/jaw/measured_js", JointState))

    @property
    def felt(self):
        return self.behind.newest.values()


def test_a_leader_turns_the_tool_by_differences_and_gets_wrench_and_grip(space, made):
    hand = Hand(space)
    with hand.behind:
        leader = made(Leader(space, 3, jaw_m=0.04, max_grip_n=5.0, **ALL))
        assert hold(leader, (0.0,) * 7, 1.0) == close((0.0,) * 6 + (0.02,))  # the opening comes at 50 mm/s
        hand.turn = product(quaternion_of((0.0, 0.0, 2.0)), HOME)
        hold(leader, (0.0,) * 7, 0.3)
        hand.turn = tuple(-each for each in product(quaternion_of((0.0, 0.0, 4.0)), HOME))  # over half a turn
        assert hold(leader, (0.5, 0.0, -0.5, 0.03, 0.0, 0.04, -3.0), 0.7)[3:6] == close((0.0, 0.0, 4.0))
        assert hand.felt == close((-0.5, 0.0, 0.5, -0.03, 0.0, -0.04))
        assert last_of(hand.drive).effort == close([0.12])  # opens the fingers: 3 N at 40 mm
        hold(leader, (0.0, 0.0, 0.0, 0.3, 0.0, -0.4, 50.0), 0.2)
        assert hand.felt[3:] == close((-0.06, 0.0, 0.08))  # 0.1 N·m in the same direction
        assert last_of(hand.drive).effort == close([-0.2])
        leader.close()
        time.sleep(0.05)
        assert hand.felt == (0.0,) * 6
        assert last_of(hand.drive).effort == [0.0]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ((0.0,) * 4, "has no orientation: its quaternion is zero"),
        ((math.nan, 0.0, 0.0, 1.0), "has a value that is NaN"),
    ],
)
def test_a_pose_without_orientation_is_one_line_no_force_and_no_jump(space, made, caplog, wrong, said):
    hand = Hand(space)
    with hand.behind:
        leader = made(Leader(space, 3, parts="force+torque", **CALM))
        hold(leader, (0.0,) * 6, 0.2)
        hand.turn = product(quaternion_of((0.2, 0.0, 0.0)), HOME)
        assert hold(leader, (0.0,) * 3 + (0.05,) * 3, 0.6)[3:] == close((0.2, 0.0, 0.0))
        assert hand.felt[3:] == close((-0.05,) * 3)
        hand.turn = wrong
        assert hold(leader, (0.0,) * 3 + (0.05,) * 3, 0.3)[3:] == close((0.2, 0.0, 0.0))
        assert hand.felt == (0.0,) * 6
        (line,) = [each for each in caplog.messages if "measured_cp" in each]
        assert said in line
        hand.turn = quaternion_of((0.0, 2.0, 0.0))
        assert hold(leader, (0.0,) * 6, 0.1)[3:] == close((0.2, 0.0, 0.0))


def test_a_leader_that_takes_wrenches_along_its_tool_gets_them_so(space, made):
    hand = Hand(space)
    hand.turn = quaternion_of((math.pi / 2.0, 0.0, 0.0))
    with hand.behind:
        leader = made(Leader(space, 3, parts="force+torque", wrench_axes="tool", **CALM))
        hold(leader, (0.0, 0.0, 1.0, 0.0, 0.05, 0.0), 0.8)
        assert hand.felt == close((0.0, -1.0, 0.0, 0.0, 0.0, 0.05))


# Both


@pytest.mark.parametrize("axes", ["xyz", "-zxy"])
def test_a_push_a_twist_and_an_object_in_the_jaw_are_the_same_at_the_leader(space, made, axes):
    felt = {"torque": (0.04, 0.0, -0.02)}
    hand = Hand(f"{space}/MTML")
    robot = Robot(f"{space}/PSM1", axes, **ALL)
    with (
        hand.behind,
        arm_behind(f"{space}/PSM1", lambda: wrench(1.0, 0.0, -0.5, **felt), lambda: joint(0.02, -1.0)) as arm,
        hn.ThreadedSlave(robot, listen="127.0.0.1:0") as slave,
    ):
        leader = made(Leader(f"{space}/MTML", axes, jaw_m=0.04, **ALL))
        with hn.ThreadedMaster(slave.address, operator=leader, codec="raw"):
            time.sleep(1.5)
            hand.turn = product(quaternion_of((0.0, 0.3, 0.0)), HOME)
            time.sleep(0.6)
            assert hand.felt == close((1.0, 0.0, -0.5, 0.04, 0.0, -0.02))  # +x at the robot pushes +x at the hand
            assert last_of(hand.drive).effort[0] == close(0.04)  # 1 N opens the fingers, as it does the jaw
            away = product(turn_of(arm.newest), inverse(HOME))
            assert vector_near(away, (0.0,) * 3) == close((0.0, 0.3, 0.0))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"parts": "torque"}, "parts is 'torque'; it must be force, force.torque"),
        ({"parts": "force+torque", "axes": "-z"}, "an orientation and a torque need three"),
        ({"wrench_axes": "world"}, "must be base or tool"),
        ({"jaw_m": 0.0, "parts": "force+grip"}, "jaw_m is 0.0"),
    ],
)
@pytest.mark.parametrize("made_of", [Robot, Leader])
def test_parts_that_cannot_be_used_are_said_in_one_sentence(made_of, given, said):
    with pytest.raises(SettingsError, match=said):
        made_of(**HERE | given)
