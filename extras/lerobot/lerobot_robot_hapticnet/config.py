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
    """What a hand moves, and its units: joints or Cartesian axes, an orientation, and a gripper."""

    joints: str = "x"
    """One to three names, separated by ``+``."""
    turns: str = ""
    """None to three names. Three are a rotation vector in fixed axes; one or two are angles of joints."""
    gripper: str = ""
    """One name, or none."""
    units_per_m: float = 1.0
    """Units of the robot (degrees, per cent, metres) in one metre of the hand; negative turns the direction round."""
    units_per_rad: float = 1.0
    """The same in one radian, for `turns`."""
    gripper_units_per_m: float = 1.0
    """The same in one metre of the hand's opening, for `gripper`; positive opens."""
    zero: float = 0.0
    """Value of a joint at position 0 of the hand."""
    gripper_zero: float = 0.0
    """Value of the gripper when the hand is closed."""

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in the order of hapticnet's axes; SettingsError if they are unusable, or a unit is invalid."""
        joints, turns = _split(self.joints), _split(self.turns)
        names = *joints, *turns, *_split(self.gripper)
        if not 1 <= len(joints) <= 3 or not all(joints):
            raise SettingsError(f"joints is {self.joints!r}; it must be one to three names, as in x+y+z")
        if len(turns) > 3 or not all(turns):
            raise SettingsError(f"turns is {self.turns!r}; it must be up to three names, as in wx+wy+wz")
        if len(names) > len(joints) + len(turns) + 1 or len(set(names)) != len(names):
            raise SettingsError(f"the names {', '.join(names)} must be different ones, with one gripper at most")
        for name in ("units_per_m", "units_per_rad", "gripper_units_per_m"):
            unit = getattr(self, name)
            if not math.isfinite(unit) or not unit:
                raise SettingsError(f"{name} is {unit!r}; it must be a number other than 0")
        check_parameter("zero", self.zero, -1e6, 1e6)
        check_parameter("gripper_zero", self.gripper_zero, -1e6, 1e6)
        return names

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of hapticnet, such as ``("force:3", "torque:3", "grip:1")``."""
        found = {"force": len(_split(self.joints)), "torque": len(_split(self.turns)), "grip": int(bool(self.gripper))}
        return tuple(f"{kind}:{axes}" for kind, axes in found.items() if axes)

    @property
    def turn_at(self) -> slice:
        """Where the turns stand among the names."""
        first = len(_split(self.joints))
        return slice(first, first + len(_split(self.turns)))

    @property
    def has_vector(self) -> bool:
        """Whether the turns are a rotation vector."""
        return len(_split(self.turns)) == 3

    @property
    def felt_keys(self) -> tuple[str, ...]:
        """Keys of what is felt: ``JOINT.force`` [N], ``TURN.torque`` [N·m], ``GRIPPER.force`` [N]."""
        turns = _split(self.turns)
        return tuple(f"{name}.{'torque' if name in turns else 'force'}" for name in self.names)

    def by_kind(self, joint: float, turn: float, gripper: float) -> tuple[float, ...]:
        """Return one number for each name: that of a joint, a turn or the gripper."""
        made = *[joint] * len(_split(self.joints)), *[turn] * len(_split(self.turns))
        return (*made, gripper) if self.gripper else made

    @property
    def units(self) -> tuple[float, ...]:
        """Units of the robot in one unit of the hand, for each name."""
        return self.by_kind(self.units_per_m, self.units_per_rad, self.gripper_units_per_m)

    def position(self, action: dict[str, Any]) -> tuple[float, ...]:
        """Return the position [m, rad, m] that an action asks for; ValueError if one is missing or not finite."""
        try:
            values = [float(action[f"{name}.pos"]) for name in self.names]
        except (KeyError, TypeError, ValueError) as error:
            wanted = ", ".join(self.position_keys)
            raise ValueError(f"the action {action!r} must have a number as {wanted}") from error
        if not all(math.isfinite(each) for each in values):
            raise ValueError(f"the action {action!r} is not finite; the robot stays where it is")
        zeros = self.by_kind(self.zero, 0.0, self.gripper_zero)
        return tuple((each - zero) / unit for each, zero, unit in zip(values, zeros, self.units, strict=True))

    def action(self, position: Sequence[float]) -> dict[str, float]:
        """Return a position [m, rad, m] as an action."""
        zeros = self.by_kind(self.zero, 0.0, self.gripper_zero)
        values = [zero + unit * each for each, zero, unit in zip(position, zeros, self.units, strict=True)]
        return dict(zip(self.position_keys, values, strict=True))

    @property
    def position_keys(self) -> tuple[str, ...]:
        """Keys of an action: ``NAME.pos``."""
        return tuple(f"{name}.pos" for name in self.names)


def _split(names: str) -> tuple[str, ...]:
    return tuple(each.strip() for each in names.split("+")) if names else ()


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
    turn_stiffness_nm_per_rad: float = 0.0
    """The same for ``turn_stiffness``."""
    grip_stiffness_n_per_m: float = 0.0
    """The same for ``grip_stiffness``."""


@TeleoperatorConfig.register_subclass("hapticnet")
@dataclass(kw_only=True)
class HapticnetTeleoperatorConfig(TeleoperatorConfig, Session):
    """A hand that feels the force of the session with `address`, or without one the force given to `send_feedback`."""

    hand: str = "haply"
    """What ``hapticnet master --operator`` takes: haply, hand:arm, FILE.py:Class, udp:PORT, ..."""
