"""A leader of ROS 2 as an operator: measured_cp moves the tool, and the held force goes to servo_cf."""

import math
import time
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.samples import PositionSample, Vector
from hapticnet_ros2.messages import WrenchStamped
from hapticnet_ros2.robot import kind_of
from hapticnet_ros2.settings import axes_from, topic_from
from hapticnet_ros2.topics import FRESH_MS, Input, Output, participant

USUAL_N: Final = 2.0
RISE_S: Final = 0.5  # time in which the limit of the force rises from zero once the hand holds the tool: an assumption
SLEW_N_PER_S: Final = 200.0  # largest rise of the force, as for the Inverse3: an assumption
LONGEST_STEP_S: Final = 0.005  # longest time between two forces that lets the force rise


class Leader:
    """A device with force that speaks CRTK's names. Satisfies `hapticnet.operator.base.HasSample`.

    The tool begins at 0 and moves as the device does from its first message on, and from the first after a fault, so
    that it never jumps; the force then rises from zero. Without fresh messages the tool stays and the force decays.

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
    position_topic, force_topic, message, frame_id
        Names of the topics, kind of the positions, and frame in the messages sent.
    domain, interface
        Domain of DDS (default: ROS_DOMAIN_ID, or 0) and network interface.
    reliable
        Whether servo_cf is offered to subscribers that ask for reliable messages too.
    fresh_ms
        Age [ms] of a position from which the force decays; at twice that age it is zero, and the tool is let go.
    """

    def __init__(
        self,
        namespace: str = "",
        axes: str | int = "-z",
        scale: float = 1.0,
        max_force_n: float = USUAL_N,
        position_topic: str = "measured_cp",
        force_topic: str = "servo_cf",
        message: str = "PoseStamped",
        frame_id: str = "",
        domain: int | None = None,
        interface: str = "",
        reliable: bool = True,
        fresh_ms: float = FRESH_MS,
    ) -> None:
        self._along = axes_from(axes)
        self.axes = len(self._along)
        check_parameter("scale", scale, 1e-3, 1e3)
        check_parameter("max_force_n", max_force_n, 0.01, 100.0, "N")
        self._scale, self.max_force_n = scale, max_force_n
        kind = kind_of(message)
        member = participant(domain, interface)
        self._measured = Input(member, topic_from(namespace, position_topic), kind, fresh_ms)
        force_name = topic_from(namespace, force_topic)
        self._sent = Output(member, force_name, WrenchStamped, frame_id, reliable=reliable is True)
        self._is_open = True
        self._tool_m: Vector = (0.0,) * self.axes
        self._offset_m = self._tool_m
        self._held_s: float | None = None  # since when the hand holds the tool
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
        """Send the force [N] nearest to the one held that the limits allow."""
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
