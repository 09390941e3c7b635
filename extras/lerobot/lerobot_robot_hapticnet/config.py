"""Settings of the robot and the teleoperator, as LeRobot's command line takes them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError


@dataclass(kw_only=True)
class Joints:
    """One to three joints, or Cartesian axes, and their units."""

    joints: str = "x"
    """Their names, separated by ``+``."""
    units_per_m: float = 1.0
    """Units of the robot (degrees, per cent, metres) in one metre of the hand; negative turns the direction round."""
    zero: float = 0.0
    """Value of a joint at position 0 of the hand."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names; SettingsError if they are not one to three different names, or a unit is invalid."""
        names = tuple(each.strip() for each in self.joints.split("+"))
        if not 1 <= len(names) <= 3 or not all(names) or len(set(names)) != len(names):
            raise SettingsError(f"joints is {self.joints!r}; it must be one to three names, as in x+y+z")
        if not math.isfinite(self.units_per_m) or not self.units_per_m:
            raise SettingsError(f"units_per_m is {self.units_per_m!r}; it must be a number other than 0")
        check_parameter("zero", self.zero, -1e6, 1e6)
        return names

    def position_m(self, action: dict[str, Any]) -> tuple[float, ...]:
        """Return the position [m] that an action asks for; ValueError if one is missing or not finite."""
        try:
            values = [float(action[f"{name}.pos"]) for name in self.names]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"the action {action!r} must have a number as {self.keys('pos')}") from error
        if not all(math.isfinite(each) for each in values):
            raise ValueError(f"the action {action!r} is not finite; the robot stays where it is")
        return tuple((each - self.zero) / self.units_per_m for each in values)

    def action(self, position_m: Sequence[float]) -> dict[str, float]:
        """Return a position [m] as an action."""
        return {
            f"{name}.pos": self.zero + self.units_per_m * each
            for name, each in zip(self.names, position_m, strict=True)
        }

    def keys(self, kind: str) -> str:
        """Return the keys of the joints as text for a message."""
        return ", ".join(f"{name}.{kind}" for name in self.names)


@dataclass(kw_only=True)
class Session(Joints):
    """The session with the slave beside the robot. See docs/refer/api.md for what hapticnet's own options mean."""

    address: str = ""
    codec: str = "motion-predictive"
    coupling: str = "energy-bounded"
    predicted: bool = False
    rate_hz: float = 500.0
    """Positions sent, and forces given to the hand, in a second."""
    key: str | None = None
    peer_key: str | None = None
    insecure: bool = False


@RobotConfig.register_subclass("hapticnet")
@dataclass(kw_only=True)
class HapticnetRobotConfig(RobotConfig, Session):
    """A robot at another place."""

    address: str = "127.0.0.1:47800"
    stiffness_n_per_m: float = 0.0
    """The follower's option ``stiffness``, with which the robot's position is computed from the force; 0: not given."""


@TeleoperatorConfig.register_subclass("hapticnet")
@dataclass(kw_only=True)
class HapticnetTeleoperatorConfig(TeleoperatorConfig, Session):
    """A hand that feels the force of the session with `address`, or without one the force given to `send_feedback`."""

    hand: str = "haply"
    """What ``hapticnet master --operator`` takes: haply, hand:arm, FILE.py:Class, udp:PORT, ..."""
