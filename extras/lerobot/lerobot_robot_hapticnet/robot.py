"""The robot at another place, as LeRobot sees it."""

from typing import Any

from lerobot.robots import Robot

from lerobot_robot_hapticnet.config import HapticnetRobotConfig
from lerobot_robot_hapticnet.link import Link
from lerobot_robot_hapticnet.session_end import SessionEnd


class HapticnetRobot(SessionEnd, Robot):
    """A LeRobot robot at another place, which a `Follower` there moves.

    Observations are ``JOINT.pos`` and ``JOINT.force`` [N]. A session carries forces, not positions. So ``JOINT.pos`` is
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
        """Position and force of each joint."""
        return {**self.action_features, **{f"{name}.force": float for name in self.config.names}}

    def get_observation(self) -> dict[str, Any]:
        """Return position and force; DeviceNotConnectedError if the other end has ended the session."""
        self._link.check(self)
        force_n, position_m = self._link.force_n, self._link.answered_m()
        if self.config.stiffness_n_per_m:
            position_m = tuple(
                at - force / self.config.stiffness_n_per_m for at, force in zip(position_m, force_n, strict=True)
            )
        forces = {f"{name}.force": force for name, force in zip(self.config.names, force_n, strict=True)}
        return {**self.config.action(position_m), **forces}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Move the robot, unless a hand moves it; return the action that moves it. ValueError if it is not finite."""
        tool = self._link.check(self)
        position_m = self.config.position_m(action)
        if self._link.hand:
            return self.config.action(tool.at_m)
        tool.move(position_m)
        return self.config.action(position_m)
