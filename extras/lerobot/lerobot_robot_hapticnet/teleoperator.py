"""A hand with a force, as LeRobot sees it."""

import logging
import math
from typing import Any, Final

from lerobot.teleoperators import Teleoperator

from hapticnet.errors import SettingsError
from lerobot_robot_hapticnet.config import HapticnetTeleoperatorConfig
from lerobot_robot_hapticnet.link import Link, connecting

LOG: Final = logging.getLogger("hapticnet")


class HapticnetTeleoperator(Teleoperator):
    """An operator of hapticnet: a Haply, a hand that yields, or an object of the user's.

    With an address, the force comes by the session in every tick, and `send_feedback` has nothing to do. Without one,
    it renders what `send_feedback` says, with hapticnet's hold and coupling at 1 kHz, until that is 0.1 s old.
    """

    config_class = HapticnetTeleoperatorConfig
    name = "hapticnet"

    def __init__(self, config: HapticnetTeleoperatorConfig) -> None:
        super().__init__(config)
        self.config = config
        self._link = Link.of(config)
        if self._link.is_busy:
            raise SettingsError(f"the session with {config.address} is open already; make the teleoperator before")
        self._link.hand = config.hand

    @property
    def action_features(self) -> dict[str, Any]:
        """Position of each joint."""
        return {f"{name}.pos": float for name in self.config.names}

    @property
    def feedback_features(self) -> dict[str, Any]:
        """Force [N] of each joint, positive if it pushes towards smaller positions of the hand; {} with an address."""
        return {} if self.config.address else {f"{name}.force": float for name in self.config.names}

    @property
    def is_connected(self) -> bool:
        """Whether the hand is connected."""
        return self._link.is_open(self)

    @property
    def is_calibrated(self) -> bool:
        """It needs none."""
        return True

    def connect(self, calibrate: bool = True) -> None:  # noqa: ARG002 - the interface's
        """Take the hand; DeviceNotConnectedError says why it cannot be."""
        connecting(self._link, self)

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def get_action(self) -> dict[str, Any]:
        """Return where the hand is; DeviceNotConnectedError if the other end has ended the session."""
        return self.config.action(self._link.check(self).at_m)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Render the forces ``JOINT.force`` [N] of a dictionary; ignore the rest. A force that is not finite is 0."""
        self._link.check(self)
        if self._link.feedback is None:
            return
        try:
            force_n = tuple(float(feedback[f"{name}.force"]) for name in self.config.names)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"the feedback {feedback!r} must have a number as {self.config.keys('force')}") from error
        if not all(map(math.isfinite, force_n)):
            LOG.warning("the feedback %r is not finite: the force is zero", feedback)
            force_n = (0.0,) * len(force_n)
        self._link.feedback.tell(force_n)

    def disconnect(self) -> None:
        """Let the hand go: the force goes to zero."""
        self._link.leave(self)

    def report(self) -> dict[str, Any]:
        """Return the account of the session."""
        return self._link.report()
