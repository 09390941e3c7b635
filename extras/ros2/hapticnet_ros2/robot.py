"""A robot of ROS 2 as a scene: positions go to servo_cp, and measured_cf is the force."""

import time
from typing import Final, Unpack

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.samples import PositionSample, Vector
from hapticnet_ros2.messages import WrenchStamped
from hapticnet_ros2.settings import DdsOptions, axes_from, numbers_from
from hapticnet_ros2.topics import LOG, Dds, Input

RISE_S: Final = 0.02  # time in which the force comes back after a fault
LONGEST_STEP_S: Final = 0.1  # after a longer pause between two positions, the robot moves as after this one

_moving: dict[str, "Robot"] = {}  # by topic: the object whose master was welcomed last


class Robot:
    """A robot that speaks CRTK's names. Satisfies `hapticnet.scene.base.HasStep`.

    The tool starts where the robot is: the first position is wherever `measured_cp` says, and each later one is its
    difference from the first. `step` never waits.

    Parameters
    ----------
    namespace
        Of the robot's topics, such as ``/PSM1``.
    axes
        One to three axes of the robot's frame, such as ``-zxy``, or 1, 2 or 3. The first is that into what is touched.
    scale, force_scale
        Metres of the robot in one metre of the hand, and newtons of the hand in one newton of the robot. A robot that
        publishes the force that it exerts, not that which it feels, needs ``force_scale=-1``.
    speed
        Largest speed [m/s] of the commanded position.
    home, orientation
        ``X/Y/Z`` [m] and ``X/Y/Z/W``. Default: those of `measured_cp` when the first position comes.
    position_topic, measured_topic, force_topic
        Names of the topics.
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
        **options: Unpack[DdsOptions],
    ) -> None:
        self._along = axes_from(axes)
        self.axes = len(self._along)
        check_parameter("scale", scale, 1e-3, 1e3)
        check_parameter("size of force_scale", abs(force_scale), 1e-3, 1e3)
        check_parameter("speed", speed, 1e-3, 10.0, "m/s")
        dds = Dds(namespace, **options)
        self._scale, self._force_scale, self._speed = scale, force_scale, speed
        self._place = numbers_from("home", home, 3) if home else ()
        self._turn = numbers_from("orientation", orientation, 4) if orientation else ()
        if self._turn and not 0.999 < sum(each * each for each in self._turn) < 1.001:
            raise SettingsError(f"orientation is {orientation!r}; it must be a quaternion of length 1")
        self._topic = dds.name_of(position_topic)
        self.name = f"ros2:{self._topic.rpartition('/')[0] or '/'}"[:64]
        self._force = dds.input(force_topic, WrenchStamped)
        self._measured: Input | None = None
        if not (self._place and self._turn):
            self._measured = dds.input(measured_topic, dds.position_kind)
        self._sent = dds.output(position_topic, dds.position_kind)
        self._zero_m: Vector = ()  # position of the hand that belongs to home
        self._at_m: list[float] = []  # where the tool is, from home
        self._before_s, self._share = 0.0, 0.0
        _moving.setdefault(self._topic, self)

    def welcome(self, master: str) -> None:  # noqa: ARG002 - every master is welcome
        """Let the master of this object move the robot. Any other master stops moving it, and feels zero force."""
        _moving[self._topic] = self

    def step(self, sample: PositionSample) -> Vector:
        """Send a position and return the force [N] that was measured last."""
        now_s = time.monotonic()
        passed_s, self._before_s = min(now_s - self._before_s, LONGEST_STEP_S), now_s
        if _moving.get(self._topic) is not self:
            if self._share > 0.0:
                LOG.warning(f"{self.name} is moved by another master; the force is zero")
            self._share = 0.0
            return (0.0,) * self.axes
        self._force.poll(now_s)
        self._sent.watch(now_s)
        if not self._zero_m and not self._begin(sample.position_m, now_s):
            return (0.0,) * self.axes
        self._move(sample.position_m, passed_s)
        self._share = min(self._force.share(now_s), self._share + passed_s / RISE_S)
        if self._share <= 0.0 or not (values := self._force.newest.values):
            return (0.0,) * self.axes
        # What pushes the tool against an axis pushes the hand out
        gain = -self._force_scale * self._share
        return tuple([gain * sign * values[axis] for axis, sign in self._along])

    def _begin(self, position_m: Vector, now_s: float) -> bool:
        """Take the robot where it is; return whether that is known."""
        if self._measured is not None:
            self._measured.poll(now_s)
            if not (values := self._measured.usable(now_s)):
                return False
            self._place, self._turn = self._place or values[:3], self._turn or values[3:]
        self._zero_m, self._at_m = position_m, [0.0] * self.axes
        return True

    def _move(self, position_m: Vector, passed_s: float) -> None:
        most_m = self._speed * passed_s
        place = list(self._place)
        for index, (axis, sign) in enumerate(self._along):
            away_m = self._scale * (position_m[index] - self._zero_m[index]) - self._at_m[index]
            self._at_m[index] += min(max(away_m, -most_m), most_m)
            place[axis] += sign * self._at_m[index]
        self._sent.send((*place, *self._turn))

    def close(self) -> None:
        """Leave the topics; the robot stays where it was sent last."""
        if _moving.get(self._topic) is self:
            del _moving[self._topic]
        for each in (self._force, self._measured, self._sent):
            if each is not None:
                each.close()
