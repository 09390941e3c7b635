"""Messages of ROS 2 as DDS has them: the fields of each ``.msg`` in order, and ROS's type names with ``dds_``."""

import math
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int32, sequence, uint32

PREFIX: Final = "rt"  # of topics, before the name that ROS shows

if TYPE_CHECKING:  # a list to Python, and a sequence to cyclonedds
    Texts = list[str]
    Numbers = list[float]
else:
    Texts = sequence[str]
    Numbers = sequence[float]


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """``builtin_interfaces/msg/Time``."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """``std_msgs/msg/Header``."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    """``geometry_msgs/msg/Vector3``."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    """``geometry_msgs/msg/Point``."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    """``geometry_msgs/msg/Quaternion``."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


def _position_and_quaternion(at: Point | Vector3, turn: Quaternion) -> tuple[float, ...]:
    return at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    """``geometry_msgs/msg/Pose``."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    """``geometry_msgs/msg/PoseStamped``."""

    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)

    def values(self) -> tuple[float, ...]:
        """Return position [m] and orientation."""
        return _position_and_quaternion(self.pose.position, self.pose.orientation)

    def put(self, values: tuple[float, ...]) -> None:
        """Set position [m] and orientation."""
        self.pose = Pose(Point(*values[:3]), Quaternion(*values[3:]))


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    """``geometry_msgs/msg/Transform``."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    """``geometry_msgs/msg/TransformStamped``: what CRTK had for positions before its version 1.2."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)

    def values(self) -> tuple[float, ...]:
        """Return position [m] and orientation."""
        return _position_and_quaternion(self.transform.translation, self.transform.rotation)

    def put(self, values: tuple[float, ...]) -> None:
        """Set position [m] and orientation."""
        self.transform = Transform(Vector3(*values[:3]), Quaternion(*values[3:]))


@dataclass
class Wrench(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    """``geometry_msgs/msg/Wrench``."""

    force: Vector3 = field(default_factory=Vector3)
    torque: Vector3 = field(default_factory=Vector3)


@dataclass
class WrenchStamped(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    """``geometry_msgs/msg/WrenchStamped``."""

    header: Header = field(default_factory=Header)
    wrench: Wrench = field(default_factory=Wrench)

    def values(self) -> tuple[float, ...]:
        """Return force [N] and torque [N·m]."""
        force, torque = self.wrench.force, self.wrench.torque
        return force.x, force.y, force.z, torque.x, torque.y, torque.z

    def put(self, values: tuple[float, ...]) -> None:
        """Set the force [N] and the torque [N·m]; without one it stays zero."""
        self.wrench = Wrench(Vector3(*values[:3]), Vector3(*values[3:]))


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """``sensor_msgs/msg/JointState`` of one joint."""

    header: Header = field(default_factory=Header)
    name: Texts = field(default_factory=list)
    position: Numbers = field(default_factory=list)
    velocity: Numbers = field(default_factory=list)
    effort: Numbers = field(default_factory=list)

    def values(self) -> tuple[float, ...]:
        """Return position [m or rad] and effort [N or N·m], NaN where there is not one."""
        position, effort = (each[0] if len(each) == 1 else math.nan for each in (self.position, self.effort))
        return position, effort

    def put(self, values: tuple[float, ...]) -> None:
        """Set position and effort, except where they are NaN."""
        self.name = ["jaw"]
        self.position, self.effort = ([] if math.isnan(each) else [each] for each in values)


Message = PoseStamped | TransformStamped | WrenchStamped | JointState
POSITIONS: Final[dict[str, type[PoseStamped] | type[TransformStamped]]] = {
    "PoseStamped": PoseStamped,
    "TransformStamped": TransformStamped,
}


def made(kind: type[Message], values: tuple[float, ...], frame_id: str) -> Message:
    """Return a message of a kind with values, stamped now."""
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    message = kind(header=Header(Time(seconds, nanoseconds), frame_id))
    message.put(values)
    return message
