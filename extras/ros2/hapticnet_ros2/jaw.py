"""The jaw of a robot or leader, as CRTK has it: a joint of its own, with position and effort."""

import math
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet_ros2.messages import JointState
from hapticnet_ros2.topics import Dds, FaultOf

BACK_M_PER_S: Final = 0.05  # speed at which the openings of hand and jaw become equal: an assumption


class Opening:
    """An opening [m] that follows another one without a jump: their first difference vanishes slowly."""

    def __init__(self, at_m: float = 0.0) -> None:
        self.at_m = at_m
        self._offset_m: float | None = None

    def follow(self, opening_m: float, passed_s: float, speed: float = math.inf) -> None:
        """Follow, from where this opening is, at most at a speed [m/s]."""
        if self._offset_m is None:
            self._offset_m = self.at_m - opening_m
        size_m = max(abs(self._offset_m) - BACK_M_PER_S * passed_s, 0.0)
        self._offset_m = math.copysign(size_m, self._offset_m)
        away_m, most_m = opening_m + self._offset_m - self.at_m, speed * passed_s
        self.at_m += min(max(away_m, -most_m), most_m)

    def stop(self) -> None:
        """Stay here until the next call of `follow`."""
        self._offset_m = None


class Jaw:
    """Topics of a jaw, in metres and newtons between the fingers.

    `jaw_m` is the opening [m] for one unit of the joint's position, so an effort is newtons times `jaw_m`.
    """

    def __init__(self, dds: Dds, name: str, jaw_m: float, sent: str, fault_of: FaultOf) -> None:
        check_parameter("jaw_m", jaw_m, 1e-5, 10.0, "m")
        self._jaw_m = jaw_m
        self.heard = dds.input(f"{name}/measured_js", JointState, fault_of)
        self._sent = dds.output(f"{name}/{sent}", JointState)

    def poll(self, now_s: float) -> tuple[float, float] | None:
        """Return opening [m] and force of the drive [N], positive if it opens; None without a usable message."""
        self.heard.poll(now_s)
        self._sent.watch(now_s)
        values = self.heard.usable(now_s)
        return (values[0] * self._jaw_m, values[1] / self._jaw_m) if values else None

    def open(self, opening_m: float) -> None:
        """Send an opening."""
        self._sent.send((opening_m / self._jaw_m, math.nan))

    def drive(self, force_n: float) -> None:
        """Send a force of the drive, positive if it opens."""
        self._sent.send((math.nan, force_n * self._jaw_m))

    def close(self) -> None:
        """Leave the topics."""
        self.heard.close()
        self._sent.close()
