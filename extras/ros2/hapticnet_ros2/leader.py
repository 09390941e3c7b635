"""A leader of ROS 2 as an operator: measured_cp moves the tool, and the held force goes to servo_cf."""

import math
import time
from typing import Final, Unpack

from hapticnet.checks import check_parameter
from hapticnet.samples import PositionSample, Vector
from hapticnet_ros2.messages import WrenchStamped
from hapticnet_ros2.settings import DdsOptions, axes_from
from hapticnet_ros2.topics import Dds

DEFAULT_MAX_FORCE_N: Final = 2.0
RISE_S: Final = 0.5  # time in which the force limit rises from zero after positions begin to come: an assumption
SLEW_N_PER_S: Final = 200.0  # fastest rise of the force, the same as for the Inverse3: an assumption
LONGEST_STEP_S: Final = 0.005  # longest time that counts between two forces when the force rises


class Leader:
    """A device with force that speaks CRTK's names. Satisfies `hapticnet.operator.base.HasSample`.

    The tool begins at 0. From the first message of the device, and from the first one after a fault, the tool moves by
    the same differences as the device, so that it never jumps, and the force rises from zero. Without fresh messages
    the tool stays where it is and the force decays.

    Parameters
    ----------
    namespace
        Of the device's topics, such as ``/MTML``.
    axes
        One to three axes of the device's frame, such as ``-zxy``, or 1, 2 or 3. The first is that into what is touched.
    scale
        Metres of the tool in one metre of the device. Forces are not scaled.
    max_force_n
        Largest force [N] that is sent to the device, of all axes together.
    position_topic, force_topic
        Names of the topics.
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
        **options: Unpack[DdsOptions],
    ) -> None:
        self._along = axes_from(axes)
        self.axes = len(self._along)
        check_parameter("scale", scale, 1e-3, 1e3)
        check_parameter("max_force_n", max_force_n, 0.01, 100.0, "N")
        self._scale, self.max_force_n = scale, max_force_n
        dds = Dds(namespace, **options)
        self._measured = dds.input(position_topic, dds.position_kind)
        self._sent = dds.output(force_topic, WrenchStamped)
        self._is_open = True
        self._tool_m: Vector = (0.0,) * self.axes
        self._offset_m = self._tool_m
        self._held_s: float | None = None  # when positions began to come; None while none come
        self._before_s, self._size_n = 0.0, 0.0

    def sample(self, t_us: int) -> PositionSample:
        """Return where the tool is."""
        now_s = time.monotonic()
        self._measured.poll(now_s)
        self._sent.watch(now_s)
        if values := self._measured.usable(now_s):
            at_m = [self._scale * sign * values[axis] for axis, sign in self._along]
            if self._held_s is None:
                self._held_s = now_s
                self._offset_m = tuple([tool - at for tool, at in zip(self._tool_m, at_m, strict=True)])
            self._tool_m = tuple([at + offset for at, offset in zip(at_m, self._offset_m, strict=True)])
        else:
            self._held_s = None
        return PositionSample(t_us, self._tool_m)

    def feel(self, t_us: int, force_n: Vector) -> None:  # noqa: ARG002 - the clock of the device counts
        """Send the held force [N], reduced to what the limits allow."""
        now_s = time.monotonic()
        passed_s, self._before_s = min(now_s - self._before_s, LONGEST_STEP_S), now_s
        most_n = 0.0
        if self._held_s is not None:
            most_n = self.max_force_n * min((now_s - self._held_s) / RISE_S, self._measured.share(now_s))
        size_n = math.hypot(*force_n)
        self._size_n = min(size_n, most_n, self._size_n + SLEW_N_PER_S * passed_s)
        share = self._size_n / size_n if size_n > 0.0 else 0.0
        device_n = [0.0, 0.0, 0.0]
        for (axis, sign), each_n in zip(self._along, force_n, strict=True):
            device_n[axis] = -sign * share * each_n  # a positive force pushes the hand back along the axis
        self._sent.send(tuple(device_n))

    def close(self) -> None:
        """Send a force of zero and leave the topics."""
        if self._is_open:
            self._is_open = False
            self._sent.send((0.0, 0.0, 0.0))
            self._measured.close()
            self._sent.close()
