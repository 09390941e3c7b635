"""A leader of ROS 2 as an operator: measured_cp moves the tool, and the held force or wrench goes to servo_cf."""

import math
import time
from typing import Final, Unpack

from hapticnet.checks import check_parameter
from hapticnet.rotations import NO_TURN, Quaternion, inverse, normalised, product, quaternion_of, vector_near
from hapticnet.samples import PositionSample, Vector
from hapticnet_ros2.frames import Frame
from hapticnet_ros2.jaw import Jaw, Opening
from hapticnet_ros2.messages import WrenchStamped
from hapticnet_ros2.settings import DdsOptions
from hapticnet_ros2.topics import Dds, Input, fault_of_numbers, fault_of_pose, fault_of_position

DEFAULT_MAX_FORCE_N: Final = 2.0
DEFAULT_MAX_TORQUE_NM: Final = 0.1
RISE_S: Final = 0.5  # time in which the force limit rises from zero after positions begin to come: an assumption
SLEW_N_PER_S: Final = 200.0  # fastest rise of force and grip, the same as for the Inverse3: an assumption
SLEW_NM_PER_S: Final = 20.0  # of the torque: that force at 0.1 m
LONGEST_STEP_S: Final = 0.005  # longest time that counts between two forces when the force rises


class Limit:
    """The largest magnitude of one part that may be sent to the device.

    It rises from zero when messages begin to come, and decays with the age of the newest.
    """

    def __init__(self, most: float, slew: float) -> None:
        self._most, self._slew, self._size = most, slew, 0.0

    def limited(self, vector: Vector, share: float, passed_s: float) -> Vector:
        """Return what may be sent of a stimulus; `share` is that of the limit which holds now."""
        size = math.hypot(*vector)
        self._size = min(size, self._most * share, self._size + self._slew * passed_s)
        gain = self._size / size if size > 0.0 else 0.0
        return tuple([gain * each for each in vector])


def share_of(heard: Input, held_s: float | None, now_s: float) -> float:
    """Return the share of a limit that holds, for messages that have come since `held_s`; None: none come."""
    return 0.0 if held_s is None else min((now_s - held_s) / RISE_S, heard.share(now_s))


class Leader:
    """A device with force that speaks CRTK's names. Satisfies `hapticnet.operator.base.HasSample`.

    The tool begins at 0. From the first message of the device, and from the first one after a fault, the tool moves and
    turns by the same differences as the device, so that it never jumps, and the force rises from zero. Without fresh
    messages the tool stays where it is and the force decays. The same holds for the jaw, whose opening comes to that of
    the device slowly.

    Parameters
    ----------
    namespace
        Of the device's topics, such as ``/MTML``.
    axes
        One to three axes of the device's frame, such as ``-zxy``, or 1, 2 or 3. The first is that into what is touched.
    parts
        ``force``, ``force+torque``, ``force+grip`` or ``force+torque+grip``: what is moved, and felt.
    scale
        Metres of the tool in one metre of the device. Forces, orientations and openings are not scaled.
    max_force_n, max_torque_nm, max_grip_n
        Largest force [N], torque [N·m] and grip [N] that are sent to the device, of all axes together.
    position_topic, force_topic
        Names of the topics.
    wrench_axes
        ``base``: the device takes wrenches along the axes of the frame of its positions. ``tool``: along its tool's.
    jaw
        Namespace of the jaw.
    jaw_m
        Opening [m] for one unit of its position: 1 for a jaw in metres, the length of the fingers for one in radians.
    **options
        See `DdsOptions`. The force decays when the newest position is older than `fresh_ms`. At twice that age it is
        zero, and the tool no longer follows the device until positions come again.
    """

    def __init__(
        self,
        namespace: str = "",
        axes: str | int = "-z",
        scale: float = 1.0,
        max_force_n: float = DEFAULT_MAX_FORCE_N,
        position_topic: str = "measured_cp",
        force_topic: str = "servo_cf",
        parts: str = "force",
        max_torque_nm: float = DEFAULT_MAX_TORQUE_NM,
        max_grip_n: float = DEFAULT_MAX_FORCE_N,
        wrench_axes: str = "base",
        jaw: str = "jaw",
        jaw_m: float = 1.0,
        **options: Unpack[DdsOptions],
    ) -> None:
        self._frame = Frame(axes, parts, wrench_axes)
        self.parts = self._frame.parts
        self._axes = len(self._frame.along)
        check_parameter("scale", scale, 1e-3, 1e3)
        check_parameter("max_force_n", max_force_n, 0.01, 100.0, "N")
        check_parameter("max_torque_nm", max_torque_nm, 1e-3, 10.0, "N·m")
        check_parameter("max_grip_n", max_grip_n, 0.01, 100.0, "N")
        self._scale, self.max_force_n = scale, max_force_n
        self._force, self._grip = Limit(max_force_n, SLEW_N_PER_S), Limit(max_grip_n, SLEW_N_PER_S)
        self._torque = Limit(max_torque_nm, SLEW_NM_PER_S)
        dds = Dds(namespace, **options)
        needs_turn = self._frame.turns or self._frame.is_tool
        self._measured = dds.input(position_topic, dds.position_kind, fault_of_pose if needs_turn else fault_of_numbers)
        self._sent = dds.output(force_topic, WrenchStamped)
        self._jaw = Jaw(dds, jaw, jaw_m, "servo_jf", fault_of_position) if self._frame.grips else None
        self._is_open = True
        self._tool_m: Vector = (0.0,) * self._axes
        self._tool_rad: Vector = (0.0,) * 3 if self._frame.turns else ()
        self._opening = Opening()
        self._offset_m = self._tool_m
        self._offset_turn = NO_TURN
        self._device_turn: Quaternion | None = None  # of the device, if its wrench turns with it
        self._held_s: float | None = None  # when positions began to come; None while none come
        self._jaw_held_s: float | None = None
        self._before_s = self._moved_s = 0.0

    def sample(self, t_us: int) -> PositionSample:
        """Return where the tool is."""
        now_s = time.monotonic()
        passed_s, self._moved_s = min(now_s - self._moved_s, LONGEST_STEP_S), now_s
        self._measured.poll(now_s)
        self._sent.watch(now_s)
        if values := self._measured.usable(now_s):
            self._follow(values, now_s)
        else:
            self._held_s = None
        place = *self._tool_m, *self._tool_rad
        if self._jaw is None:
            return PositionSample(t_us, place)
        if found := self._jaw.poll(now_s):
            self._jaw_held_s = self._jaw_held_s or now_s
            self._opening.follow(found[0], passed_s)
        else:
            self._jaw_held_s = None
            self._opening.stop()
        return PositionSample(t_us, (*place, self._opening.at_m))

    def _follow(self, values: Vector, now_s: float) -> None:
        """Move the tool as the device has moved."""
        begins = self._held_s is None
        at_m = [self._scale * each for each in self._frame.seen(values)]
        if begins:
            self._held_s = now_s
            self._offset_m = tuple([tool - at for tool, at in zip(self._tool_m, at_m, strict=True)])
        self._tool_m = tuple([at + offset for at, offset in zip(at_m, self._offset_m, strict=True)])
        if self._frame.turns or self._frame.is_tool:
            self._turn(normalised(values[3:]), begins=begins)

    def _turn(self, device: Quaternion, *, begins: bool) -> None:
        """Turn the tool as the device has turned."""
        self._device_turn = device if self._frame.is_tool else None
        if self._frame.turns:
            x, y, z = self._frame.turn_seen(device[:3])
            turn = x, y, z, device[3]
            if begins:
                self._offset_turn = product(inverse(turn), quaternion_of(self._tool_rad))
            self._tool_rad = vector_near(product(turn, self._offset_turn), self._tool_rad)

    def feel(self, t_us: int, force_n: Vector) -> None:  # noqa: ARG002 - the clock of the device counts
        """Send the held force [N], torque [N·m] and grip [N], reduced to what the limits allow."""
        now_s = time.monotonic()
        passed_s, self._before_s = min(now_s - self._before_s, LONGEST_STEP_S), now_s
        share = share_of(self._measured, self._held_s, now_s)
        force = self._force.limited(force_n[: self._axes], share, passed_s)
        torque = self._torque.limited(force_n[self._frame.turn_at], share, passed_s)
        # A positive stimulus pushes the hand back along its axis
        self._sent.send(tuple([-each for each in self._frame.wrench_shown(force, torque, self._device_turn)]))
        if self._jaw is not None:
            share = share_of(self._jaw.heard, self._jaw_held_s, now_s)
            self._jaw.drive(-self._grip.limited(force_n[-1:], share, passed_s)[0])

    def close(self) -> None:
        """Send a force of zero and leave the topics."""
        if self._is_open:
            self._is_open = False
            self._sent.send((0.0,) * 6)
            self._measured.close()
            self._sent.close()
            if self._jaw is not None:
                self._jaw.drive(0.0)
                self._jaw.close()
