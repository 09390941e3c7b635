"""A robot of ROS 2 as a scene: positions go to servo_cp, and measured_cf is the force, or the wrench."""

import time
from typing import Final, Unpack

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.rotations import NO_TURN, Quaternion, inverse, normalised, product, quaternion_of, toward
from hapticnet.samples import PositionSample, Vector
from hapticnet_ros2.frames import Frame
from hapticnet_ros2.jaw import Jaw, Opening
from hapticnet_ros2.messages import WrenchStamped
from hapticnet_ros2.settings import DdsOptions, numbers_from
from hapticnet_ros2.topics import LOG, Dds, Input, fault_of_joint, fault_of_numbers, fault_of_pose

RISE_S: Final = 0.02  # time in which the force comes back after a fault
LONGEST_STEP_S: Final = 0.1  # after a longer pause between two positions, the robot moves as after this one

_moving: dict[str, "Robot"] = {}  # by topic: the object whose master was welcomed last


class Robot:
    """A robot that speaks CRTK's names. Satisfies `hapticnet.scene.base.HasStep`.

    The tool starts where the robot is: the first position is wherever `measured_cp` says, and each later one is its
    difference from the first. The jaw starts where it is, and comes to the opening of the hand slowly. `step` never
    waits.

    Parameters
    ----------
    namespace
        Of the robot's topics, such as ``/PSM1``.
    axes
        One to three axes of the robot's frame, such as ``-zxy``, or 1, 2 or 3. The first is that into what is touched.
    parts
        ``force``, ``force+torque``, ``force+grip`` or ``force+torque+grip``: what is felt, and moved.
    scale, force_scale
        Metres of the robot in one metre of the hand, and newtons (newton metres) of the hand in one of the robot. A
        robot that publishes the force that it exerts, not that which it feels, needs ``force_scale=-1``.
    speed, turn_speed
        Largest speed [m/s] of the commanded position and opening, and that [rad/s] of the orientation.
    home, orientation
        ``X/Y/Z`` [m] and ``X/Y/Z/W``. Default: those of `measured_cp` when the first position comes.
    position_topic, measured_topic, force_topic
        Names of the topics.
    wrench_axes
        ``base``: wrenches are along the axes of the frame of the positions. ``tool``: along those of the tool.
    jaw
        Namespace of the jaw.
    jaw_m
        Opening [m] for one unit of its position: 1 for a jaw in metres, the length of the fingers for one in radians.
    grip_scale
        Newtons of the hand in one newton of the jaw. The effort is that of the drive, positive if it opens; a robot
        that publishes that of what is held needs ``grip_scale=-1``.
    **options
        See `DdsOptions`. The force decays from the age `fresh_ms`, and is zero at twice that age.
    """

    def __init__(
        self,
        namespace: str = "",
        axes: str | int = "-z",
        scale: float = 1.0,
        force_scale: float = 1.0,
        speed: float = 0.5,
        home: str = "",
        orientation: str = "",
        position_topic: str = "servo_cp",
        measured_topic: str = "measured_cp",
        force_topic: str = "measured_cf",
        parts: str = "force",
        turn_speed: float = 2.0,
        wrench_axes: str = "base",
        jaw: str = "jaw",
        jaw_m: float = 1.0,
        grip_scale: float = 1.0,
        **options: Unpack[DdsOptions],
    ) -> None:
        self._frame = Frame(axes, parts, wrench_axes)
        self.parts = self._frame.parts
        self._axes = len(self._frame.along)
        self._nothing: Vector = (0.0,) * (self._axes * (1 + self._frame.turns))
        check_parameter("scale", scale, 1e-3, 1e3)
        check_parameter("size of force_scale", abs(force_scale), 1e-3, 1e3)
        check_parameter("size of grip_scale", abs(grip_scale), 1e-3, 1e3)
        check_parameter("speed", speed, 1e-3, 10.0, "m/s")
        check_parameter("turn_speed", turn_speed, 1e-2, 100.0, "rad/s")
        dds = Dds(namespace, **options)
        self._scale, self._force_scale, self._grip_scale = scale, force_scale, grip_scale
        self._speed, self._turn_speed = speed, turn_speed
        self._place = numbers_from("home", home, 3) if home else ()
        self._turn = numbers_from("orientation", orientation, 4) if orientation else ()
        if self._turn and not 0.999 < sum(each * each for each in self._turn) < 1.001:
            raise SettingsError(f"orientation is {orientation!r}; it must be a quaternion of length 1")
        self._topic = dds.name_of(position_topic)
        space = self._topic.rpartition("/")[0] or "/"
        self.name, self.frame = f"ros2:{space}"[:64], f"{self._frame.text} of {space}"[:64]
        self._force = dds.input(force_topic, WrenchStamped)
        self._measured: Input | None = None
        if not (self._place and self._turn):
            needs_turn = not self._turn and (self._frame.turns or self._frame.is_tool)
            fault_of = fault_of_pose if needs_turn else fault_of_numbers
            self._measured = dds.input(measured_topic, dds.position_kind, fault_of)
        self._sent = dds.output(position_topic, dds.position_kind)
        self._jaw = Jaw(dds, jaw, jaw_m, "servo_jp", fault_of_joint) if self._frame.grips else None
        self._zero_m: Vector = ()  # position of the hand that belongs to home
        self._zero_turn = NO_TURN  # the opposite of the orientation of the hand that belongs to that of home
        self._at_m: list[float] = []  # where the tool is, from home
        self._turned: Quaternion = NO_TURN  # how the tool is turned, from home
        self._opening: Opening | None = None
        self._before_s, self._share, self._grip_share = 0.0, 0.0, 0.0
        _moving.setdefault(self._topic, self)

    def welcome(self, master: str) -> None:  # noqa: ARG002 - every master is welcome
        """Let the master of this object move the robot. Any other master stops moving it, and feels zero force."""
        _moving[self._topic] = self

    def step(self, sample: PositionSample) -> Vector:
        """Send a position and return the force [N] that was measured last, with torque [N·m] and grip [N] if wanted."""
        now_s = time.monotonic()
        passed_s, self._before_s = min(now_s - self._before_s, LONGEST_STEP_S), now_s
        if _moving.get(self._topic) is not self:
            if self._share > 0.0 or self._grip_share > 0.0:
                LOG.warning(f"{self.name} is moved by another master; the force is zero")
            self._share = self._grip_share = 0.0
            return (0.0,) * len(sample.position_m)
        felt = self._arm(sample.position_m, passed_s, now_s)
        if self._jaw is not None:
            felt = *felt, self._fingers(self._jaw, sample.position_m[-1], passed_s, now_s)
        return felt

    def _arm(self, position_m: Vector, passed_s: float, now_s: float) -> Vector:
        """Move the tool; return force and torque."""
        self._force.poll(now_s)
        self._sent.watch(now_s)
        if not self._zero_m and not self._begin(position_m, now_s):
            return self._nothing
        turn = self._move(position_m, passed_s)
        self._share = min(self._force.share(now_s), self._share + passed_s / RISE_S)
        if self._share <= 0.0 or not (values := self._force.newest.values):
            return self._nothing
        force, torque = self._frame.wrench_seen(values, turn if self._frame.is_tool else None)
        gain = -self._force_scale * self._share  # what pushes the tool against an axis pushes the hand out
        return tuple([gain * each for each in (*force, *torque)])

    def _begin(self, position_m: Vector, now_s: float) -> bool:
        """Take the robot where it is; return whether that is known."""
        if self._measured is not None:
            self._measured.poll(now_s)
            if not (values := self._measured.usable(now_s)):
                return False
            self._place, self._turn = self._place or values[:3], self._turn or values[3:]
        self._zero_m, self._at_m = position_m, [0.0] * self._axes
        if self._frame.turns or self._frame.is_tool:
            self._turn = normalised(self._turn)
        if self._frame.turns:
            self._zero_turn = inverse(quaternion_of(position_m[self._frame.turn_at]))
        return True

    def _move(self, position_m: Vector, passed_s: float) -> Quaternion:
        """Send where the tool is to be; return its orientation."""
        most_m = self._speed * passed_s
        for index in range(self._axes):
            away_m = self._scale * (position_m[index] - self._zero_m[index]) - self._at_m[index]
            self._at_m[index] += min(max(away_m, -most_m), most_m)
        place = [home + away for home, away in zip(self._place, self._frame.shown(self._at_m), strict=True)]
        x, y, z, w = self._turn
        turn: Quaternion = x, y, z, w
        if self._frame.turns:
            *axis, cosine = product(quaternion_of(position_m[self._frame.turn_at]), self._zero_turn)
            x, y, z = self._frame.turn_shown(axis)
            self._turned = toward(self._turned, (x, y, z, cosine), self._turn_speed * passed_s)
            turn = product(self._turned, turn)
        self._sent.send((*place, *turn))
        return turn

    def _fingers(self, jaw: Jaw, opening_m: float, passed_s: float, now_s: float) -> float:
        """Open or close the jaw; return the grip."""
        found = jaw.poll(now_s)
        if self._opening is None:
            if found is None:
                return 0.0
            self._opening = Opening(found[0])
        self._opening.follow(opening_m, passed_s, self._speed)
        jaw.open(self._opening.at_m)
        self._grip_share = min(jaw.heard.share(now_s), self._grip_share + passed_s / RISE_S)
        # A drive that closes the jaw holds something, which pushes the fingers of the hand open: negative too
        return self._grip_scale * self._grip_share * found[1] if found is not None else 0.0

    def close(self) -> None:
        """Leave the topics; the robot stays where it was sent last."""
        if _moving.get(self._topic) is self:
            del _moving[self._topic]
        for each in (self._force, self._measured, self._sent, self._jaw):
            if each is not None:
                each.close()
