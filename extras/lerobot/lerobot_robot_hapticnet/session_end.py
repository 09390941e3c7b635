"""What the robot and the teleoperator have in common: the actions, and the session that they share."""

from typing import Any

from lerobot_robot_hapticnet.config import Session
from lerobot_robot_hapticnet.link import Link, connecting


class SessionEnd:
    """Methods of LeRobot's `Robot` and `Teleoperator` that are the same for both."""

    config: Session
    _link: Link

    @property
    def action_features(self) -> dict[str, Any]:
        """Position of each joint, turn and gripper."""
        return dict.fromkeys(self.config.position_keys, float)

    @property
    def felt_features(self) -> dict[str, Any]:
        """Force [N] of each joint and of the gripper, and torque [N·m] of each turn."""
        return dict.fromkeys(self.config.felt_keys, float)

    @property
    def is_connected(self) -> bool:
        """Whether this end has opened the session."""
        return self._link.is_open(self)

    @property
    def is_calibrated(self) -> bool:
        """True: this end needs no calibration."""
        return True

    def connect(self, calibrate: bool = True) -> None:  # noqa: ARG002 - the interface's
        """Open the session; DeviceNotConnectedError says why it cannot be opened."""
        connecting(self._link, self)

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Leave the session. When no end is left in it, it is closed and the force goes to zero."""
        self._link.leave(self)

    def report(self) -> dict[str, Any]:
        """Return the account of the session: bytes, losses, round trip, limits; DeviceNotConnectedError without one."""
        return self._link.report()
