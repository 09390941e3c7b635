"""A hand with a force, as LeRobot sees it."""

import logging
import math
from typing import Any, Final

from lerobot.teleoperators import Teleoperator

from hapticnet.errors import SettingsError
from lerobot_robot_hapticnet.config import HapticnetTeleoperatorConfig
from lerobot_robot_hapticnet.link import Link
from lerobot_robot_hapticnet.session_end import SessionEnd

LOG: Final = logging.getLogger("hapticnet")


class HapticnetTeleoperator(SessionEnd, Teleoperator):
    """An operator of hapticnet: a Haply, a simulated hand that yields, or an object of yours.

    With an address, each tick of the session brings the force, and `send_feedback` does nothing. Without one, the hand
    feels the force given to `send_feedback`, with hapticnet's hold and coupling at 1 kHz, until it is 0.1 s old.
    """

    config: HapticnetTeleoperatorConfig
    config_class = HapticnetTeleoperatorConfig
    name = "hapticnet"

    def __init__(self, config: HapticnetTeleoperatorConfig) -> None:
        super().__init__(config)
        self.config = config
        self._link = Link.of(config)
        if self._link.is_busy:
            raise SettingsError(f"the session with {config.address} is open already; make the teleoperator first")
        self._link.hand = config.hand

    @property
    def feedback_features(self) -> dict[str, Any]:
        """Forces [N] and torques [N·m], positive if they push towards smaller positions; {} with an address."""
        return {} if self.config.address else self.felt_features

    def get_action(self) -> dict[str, Any]:
        """Return where the hand is; DeviceNotConnectedError if the other end has ended the session."""
        return self.config.action(self._link.check(self).at)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Render the forces and torques of a dictionary, with the keys of `feedback_features`; ignore the rest.

        All are 0 if one is not finite. Raises ValueError if one is missing.
        """
        self._link.check(self)
        if self._link.feedback is None:
            return
        try:
            force_n = tuple(float(feedback[key]) for key in self.config.felt_keys)
        except (KeyError, TypeError, ValueError) as error:
            wanted = ", ".join(self.config.felt_keys)
            raise ValueError(f"the feedback {feedback!r} must have a number as {wanted}") from error
        if not all(map(math.isfinite, force_n)):
            LOG.warning("the feedback %r is not finite: the force is zero", feedback)
            force_n = (0.0,) * len(force_n)
        self._link.feedback.tell(force_n)
