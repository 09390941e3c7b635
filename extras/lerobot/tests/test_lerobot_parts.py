import math

import pytest
from plugin_helpers import AT_REST, Clock, follower, play, remote, simulated, teleoperator, until
from scipy.spatial.transform import Rotation

import hapticnet as hn
from hapticnet.errors import SettingsError
from lerobot_robot_hapticnet import Follower
from lerobot_robot_hapticnet.config import Joints
from lerobot_robot_hapticnet.link import Tool

NAMES = {"joints": "x+y+z", "turns": "wx+wy+wz", "gripper": "gripper"}
ALL = NAMES | {"gripper_units_per_m": 1000.0}
KEYS = [f"{name}.pos" for name in ("x", "y", "z", "wx", "wy", "wz", "gripper")]
FELT = ["x.force", "y.force", "z.force", "wx.torque", "wy.torque", "wz.torque", "gripper.force"]
TWIST = 0.6 * 0.3 / 1.3  # N·m at a goal of 0.6 rad: servo 1 N·m/rad and spring 0.3 N·m/rad in series
PRESSED = (0.020, 0.0, 0.0, 0.0, 0.0, 0.6, -0.040)  # the gripper begins at 60 mm, and holds an object of 30 mm
FELT_AT_REST = (AT_REST, 0.0, 0.0, 0.0, 0.0, TWIST, -2.0)


class Fingers:
    """A hand that presses, turns and squeezes, and is told what it feels."""

    parts = ("force:3", "torque:3", "grip:1")
    made = ()

    def __init__(self):
        self.felt = (0.0,) * 7
        type(self).made = (self,)

    def feel(self, _t_us, felt):
        self.felt = felt

    def sample(self, t_us):
        return tuple(each * min(t_us / 400_000, 1.0) for each in PRESSED)


def is_rotation(seen, wanted):
    return (Rotation.from_rotvec(seen) * wanted.inv()).magnitude() == pytest.approx(0.0, abs=1e-3)


# The follower


@pytest.mark.parametrize(
    "options",
    [{}, {"reports_force": False, "stiffness": 300.0, "turn_stiffness": 1.0, "grip_stiffness": 300.0}, {"torque": ""}],
)
def test_the_robot_turns_and_grips_and_torque_and_grip_are_felt(tmp_path, options):
    clock = Clock()
    scene = follower(tmp_path, clock, **ALL, **options)
    assert scene.parts == ("force:3", "torque:3", "grip:1")
    assert play(scene, clock, (0.0,) * 7, 0.1) == [0.0] * 7
    assert play(scene, clock, PRESSED, 2.0) == pytest.approx(FELT_AT_REST, abs=0.01)


def test_orientations_are_turned_by_the_differences_of_the_hand(tmp_path):
    clock, (first, begun, then) = Clock(), [(0.5, 0.2, -0.4), (0.0, 1.1, 0.3), (0.9, -0.4, 1.2)]
    robot = simulated(tmp_path, clock, spring_nm_per_rad=0.0)
    scene = Follower(robot, clock=clock, turn_speed=10.0, joints="x+y+z", turns="wx+wy+wz")
    still = (0.0, 0.0, 0.0)
    play(scene, clock, still + still, 0.1)
    play(scene, clock, still + first, 1.0)
    clock.now_s += 1.0
    scene.cycle()
    scene.welcome("another")
    play(scene, clock, still + begun, 0.1)
    play(scene, clock, still + then, 1.0)
    seen = robot.get_observation()
    away = Rotation.from_rotvec(then) * Rotation.from_rotvec(begun).inv()
    assert is_rotation([seen[f"w{axis}.pos"] for axis in "xyz"], away * Rotation.from_rotvec(first))


def test_a_leap_of_orientation_is_made_slowly(tmp_path):
    clock = Clock()
    scene = follower(tmp_path, clock, turn_speed=0.5, lag_s=0.0, **ALL)
    play(scene, clock, (0.0,) * 7, 0.1)
    play(scene, clock, (0.0, 0.0, 0.0, 0.6, 0.0, -0.8, 0.0), 1.0)
    assert scene._goal[3:6] == pytest.approx([0.3, 0.0, -0.4], rel=0.02)


def test_one_turn_is_the_angle_of_a_joint_in_its_units():
    joints = Joints(
        joints="elbow_flex", turns="wrist_roll", gripper="gripper", units_per_m=300.0,
        units_per_rad=57.3, gripper_units_per_m=1000.0, gripper_zero=5.0,
    )  # fmt: skip
    assert joints.parts == ("force:1", "torque:1", "grip:1")
    assert joints.felt_keys == ("elbow_flex.force", "wrist_roll.torque", "gripper.force")
    action = {"elbow_flex.pos": 30.0, "wrist_roll.pos": 573.0, "gripper.pos": 45.0}
    assert joints.position(action) == pytest.approx((0.1, 10.0, 0.04))
    assert joints.action((0.1, 10.0, 0.04)) == pytest.approx(action)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"turns": "a+b+c+d"}, "turns is 'a.b.c.d'; it must be up to three names"),
        ({"gripper": "g+h"}, "one gripper at most"),
        ({"turns": "x"}, "must be different ones"),
        ({"gripper": "jaw"}, r"has no jaw\.pos; it has: .*gripper\.pos"),
        ({"units_per_rad": 0.0}, "units_per_rad is 0.0"),
        ({"turn_speed": 0.0}, "turn_speed"),
    ],
)
def test_names_that_cannot_be_used_are_said_at_once(options, said):
    with pytest.raises(SettingsError, match=said):
        Follower("hapticnet_simulated", **options)


# The tool of actions


def test_an_orientation_of_an_action_never_goes_the_long_way():
    tool = Tool(Joints(**NAMES), None)
    tool.at = (0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0)
    tool.move((0.0, 0.0, 0.0, 0.0, 0.0, -3.0, 0.0))
    assert tool._to[5] == pytest.approx(math.tau - 3.0)


# Sessions


@pytest.fixture
def beside_all(tmp_path):
    scene = Follower(simulated(tmp_path), units_per_m=1000.0, **ALL)
    with hn.ThreadedSlave(scene, listen="127.0.0.1:0") as slave:
        yield slave.address
    scene.close()


def test_an_action_of_all_parts_moves_the_robot_and_all_is_observed(tmp_path, beside_all):
    far = remote(
        tmp_path, beside_all, gripper_zero=60.0, turn_stiffness_nm_per_rad=1.0, grip_stiffness_n_per_m=300.0, **ALL
    )
    assert list(far.action_features) == KEYS
    assert list(far.observation_features) == KEYS + FELT
    far.connect()
    goal = dict(zip(KEYS, (20.0, 0.0, 0.0, 0.0, 0.0, 0.6, 20.0), strict=True))

    def is_there():
        assert far.send_action(goal) == pytest.approx(goal)
        seen = far.get_observation()
        turned, opened = 0.6 - TWIST, 20.0 + 1e3 * 2.0 / 300.0
        return (
            [seen[key] for key in FELT] == pytest.approx(FELT_AT_REST, rel=0.15, abs=0.01)  # a grip's JND is 7 %
            and seen["wz.pos"] == pytest.approx(turned, rel=0.05)
            and seen["gripper.pos"] == pytest.approx(opened, rel=0.05)
        )

    until(is_there)
    with pytest.raises(ValueError, match=r"must have a number as .*gripper\.pos"):
        far.send_action({"x.pos": 1.0})
    far.disconnect()


def test_a_hand_with_all_parts_feels_the_robot_of_its_address(tmp_path, beside_all):
    own = {"hand": f"{__name__}:Fingers", **ALL}
    far, hand = remote(tmp_path, beside_all, **ALL), teleoperator(tmp_path, beside_all, **own)
    for each in (far, hand):
        each.connect()
    (fingers,) = Fingers.made
    until(lambda: fingers.felt == pytest.approx(FELT_AT_REST, rel=0.15, abs=0.01))
    until(lambda: list(far.get_observation().values())[7:] == pytest.approx(FELT_AT_REST, rel=0.15, abs=0.01))
    assert list(hand.get_action().values()) == pytest.approx([20.0, 0.0, 0.0, 0.0, 0.0, 0.6, -40.0])
    for each in (far, hand):
        each.disconnect()


def test_feedback_of_all_parts_reaches_the_hand(tmp_path):
    hand = teleoperator(tmp_path, coupling="direct", hand=f"{__name__}:Fingers", **ALL)
    assert list(hand.feedback_features) == FELT
    hand.connect()
    (fingers,) = Fingers.made
    told = (1.5, -0.5, 0.0, 0.02, 0.0, -0.04, -3.0)
    feedback = dict(zip(FELT, told, strict=True))
    until(lambda: hand.send_feedback(feedback) is None and fingers.felt == pytest.approx(told, abs=0.01))
    until(lambda: hand.send_feedback(feedback | {"wy.torque": math.nan}) is None and fingers.felt == (0.0,) * 7)
    with pytest.raises(ValueError, match=r"must have a number as .*gripper\.force"):
        hand.send_feedback({"x.force": 1.0})
    hand.disconnect()


def test_a_policy_that_sends_nothing_lets_go_of_torque_and_grip_too(tmp_path, beside_all):
    far = remote(tmp_path, beside_all, **ALL)
    far.connect()
    goal = dict(zip(KEYS, (0.0, 0.0, 0.0, 0.0, 0.0, 0.6, -40.0), strict=True))
    until(lambda: far.send_action(goal) and far.get_observation()["gripper.force"] < -1.5)
    until(lambda: far.get_observation()["gripper.force"] > -0.2, 20.0)
    until(lambda: far.get_observation()["wz.torque"] < 0.03, 20.0)
    far.disconnect()
