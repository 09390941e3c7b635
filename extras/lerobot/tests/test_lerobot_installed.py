from contextlib import nullcontext

import numpy as np
import pytest
from lerobot_interface import REAL
from plugin_helpers import AT_REST, Clock, play

from lerobot_robot_hapticnet import (
    Follower,
    HapticnetRobot,
    HapticnetRobotConfig,
    HapticnetTeleoperator,
    HapticnetTeleoperatorConfig,
)


@pytest.mark.skipif(not REAL, reason="needs lerobot")
def test_lerobots_own_loop_records_what_the_hand_feels(tmp_path, beside, monkeypatch):
    import sys

    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.scripts import lerobot_record

    slave, _, _ = beside
    arguments = [
        "lerobot-record", "--robot.type=hapticnet", f"--robot.address={slave.address}", "--robot.units_per_m=1000",
        "--teleop.type=hapticnet", f"--teleop.address={slave.address}", "--teleop.units_per_m=1000",
        "--teleop.hand=plugin_helpers:made_hand:to=0.02", "--dataset.repo_id=me/felt", f"--dataset.root={tmp_path}/set",
        "--dataset.single_task=press", "--dataset.num_episodes=1", "--dataset.episode_time_s=2",
        "--dataset.push_to_hub=false", "--dataset.video=false", "--play_sounds=false",
    ]  # fmt: skip
    monkeypatch.setattr(sys, "argv", arguments)
    lerobot_record.record()
    frames = LeRobotDataset("me/felt", root=tmp_path / "set")
    assert len(frames) > 30
    names = frames.meta.features["observation.state"]["names"]
    felt = [float(each["observation.state"][names.index("x.force")]) for each in frames]
    assert felt[-1] == pytest.approx(AT_REST, rel=0.1)
    assert np.ravel(frames[len(frames) - 1]["action"])[0] == pytest.approx(20.0)


class Bus:
    """Plays the bus of an SO-101 whose elbow is blocked at 5 degrees; the gripper is open."""

    is_calibrated = True

    def __init__(self, port, motors, calibration=None):  # noqa: ARG002 - LeRobot gives it
        self.port, self.motors, self.is_connected = port, motors, False
        self.goals = {name: 50.0 if name == "gripper" else 0.0 for name in motors}

    def connect(self):
        self.is_connected = True

    def disconnect(self, _disable_torque):
        self.is_connected = False

    def torque_disabled(self):
        return nullcontext()

    def configure_motors(self):
        pass

    def write(self, *_):
        pass

    def sync_write(self, _name, values):
        self.goals |= values

    def sync_read(self, _name):
        return {**self.goals, "elbow_flex": min(self.goals["elbow_flex"], 5.0)}


@pytest.mark.skipif(not REAL, reason="needs lerobot")
def test_an_so_101_follows_with_one_joint_and_its_tracking_error_is_felt(tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot.robots.so_follower.so_follower.FeetechMotorsBus", Bus)
    clock = Clock()
    scene = Follower(
        "so101_follower", joints="elbow_flex", units_per_m=300.0, stiffness=100.0, clock=clock,
        port="/dev/none", id="arm", calibration_dir=tmp_path,
    )  # fmt: skip
    play(scene, clock, (0.0,), 0.1)
    assert play(scene, clock, (0.05,), 1.0) == pytest.approx([100.0 * 10.0 / 300.0])
    assert scene._robot.bus.goals == {
        "shoulder_pan": 0.0, "shoulder_lift": 0.0, "elbow_flex": pytest.approx(15.0), "wrist_flex": 0.0,
        "wrist_roll": 0.0, "gripper": 50.0,
    }  # fmt: skip
    scene.close()
    assert not scene._robot.is_connected


@pytest.mark.skipif(not REAL, reason="needs lerobot")
def test_lerobot_finds_the_plug_in_and_makes_both(tmp_path):
    from lerobot.robots import make_robot_from_config
    from lerobot.teleoperators import make_teleoperator_from_config

    robot = make_robot_from_config(HapticnetRobotConfig(calibration_dir=tmp_path))
    hand = make_teleoperator_from_config(HapticnetTeleoperatorConfig(calibration_dir=tmp_path, address=""))
    assert isinstance(robot, HapticnetRobot)
    assert isinstance(hand, HapticnetTeleoperator)
