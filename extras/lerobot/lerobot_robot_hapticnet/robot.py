"""The robot at another place, as LeRobot sees it."""

from typing import Any

from lerobot.robots import Robot

from lerobot_robot_hapticnet.config import HapticnetRobotConfig
from lerobot_robot_hapticnet.link import Link
from lerobot_robot_hapticnet.session_end import SessionEnd


class HapticnetRobot(SessionEnd, Robot):
    """A LeRobot robot at another place, which a `Follower` there moves.

    Observations are ``JOINT.pos`` and ``JOINT.force`` [N], ``TURN.pos`` and ``TURN.torque`` [N·m], ``GRIPPER.pos`` and
    ``GRIPPER.force`` [N]. A session carries forces, not positions. So ``NAME.pos`` is
    the position that was sent one round trip ago, to which the present force belongs. If the follower's stiffness is
    configured, force over stiffness is subtracted from it.

    If a teleoperator of this process has the same address, its hand moves the robot, and `send_action` does not.
    """

    config: HapticnetRobotConfig
    config_class = HapticnetRobotConfig
    name = "hapticnet"

    def __init__(self, config: HapticnetRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = {}  # LeRobot asks for it; the cameras of the other place do not travel
        self._link = Link.of(config)

    @property
    def observation_features(self) -> dict[str, Any]:
        """Positions, forces and torques."""
        return {**self.action_features, **self.felt_features}

    def get_observation(self) -> dict[str, Any]:
        """Return positions and forces; DeviceNotConnectedError if the other end has ended the session."""
        self._link.check(self)
        config, felt = self.config, self._link.force_n
        stiffness = config.by_kind(
            config.stiffness_n_per_m, config.turn_stiffness_nm_per_rad, config.grip_stiffness_n_per_m
        )
        position = [
            at - force / each if each else at
            for at, force, each in zip(self._link.answered(), felt, stiffness, strict=True)
        ]
        return {**config.action(position), **dict(zip(config.felt_keys, felt, strict=True))}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Move the robot, unless a hand moves it; return the action that moves it. ValueError if it is not finite."""
        tool = self._link.check(self)
        position = self.config.position(action)
        if self._link.hand:
            return self.config.action(tool.at)
        tool.move(position)
        return self.config.action(position)
