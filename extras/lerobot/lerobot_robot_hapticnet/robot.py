"""The robot at another place, as LeRobot sees it."""

from typing import Any

from lerobot.robots import Robot

from lerobot_robot_hapticnet.config import HapticnetRobotConfig
from lerobot_robot_hapticnet.link import Link, connecting


class HapticnetRobot(Robot):
    """A LeRobot robot that a `Follower` moves at another place.

    Observations are ``JOINT.pos`` and ``JOINT.force`` [N]. A session carries forces, not positions: ``JOINT.pos`` is
    the position that the present force answers, sent one round trip ago, minus force over stiffness if the follower's
    stiffness is configured.

    If a teleoperator of this process has the same address, its hand moves the robot, and `send_action` does not.
    """

    config_class = HapticnetRobotConfig
    name = "hapticnet"

    def __init__(self, config: HapticnetRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = {}  # of this place; LeRobot counts them
        self._link = Link.of(config)

    @property
    def observation_features(self) -> dict[str, Any]:
        """Position and force of each joint."""
        return {**self.action_features, **{f"{name}.force": float for name in self.config.names}}

    @property
    def action_features(self) -> dict[str, Any]:
        """Position of each joint."""
        return {f"{name}.pos": float for name in self.config.names}

    @property
    def is_connected(self) -> bool:
        """Whether the session is open."""
        return self._link.is_open(self)

    @property
    def is_calibrated(self) -> bool:
        """The robot is calibrated where it is."""
        return True

    def connect(self, calibrate: bool = True) -> None:  # noqa: ARG002 - the interface's
        """Open the session; DeviceNotConnectedError says why it cannot be."""
        connecting(self._link, self)

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

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
        """Move the robot, unless a hand does; ValueError if the action is not finite. Return what moves it."""
        tool = self._link.check(self)
        position_m = self.config.position_m(action)
        if self._link.hand:
            return self.config.action(tool.at_m)
        tool.move(position_m)
        return self.config.action(position_m)

    def disconnect(self) -> None:
        """Close the session."""
        self._link.leave(self)

    def report(self) -> dict[str, Any]:
        """Return the account of the session: bytes, losses, round trip, limits."""
        return self._link.report()
