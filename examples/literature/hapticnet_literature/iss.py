"""Input-to-state stability: a force with its rate of change, and a tool that yields to it.

After A. Jafari, M. Nabeel and J.-H. Ryu, "The input-to-state stable (ISS) approach for stabilizing haptic interaction
with virtual environments", IEEE Transactions on Robotics 33 (2017), and its two-port form for teleoperation (IEEE
7139013). A loop with hysteresis, which a late spring is, is stable if the force gets F + τ·dF/dt, and the velocity of
the tool v − (dF/dt)/µ, with µ well above the stiffness. Published (S. Bernhard, chai3d, examples/GLFW/32-spring): τ is
0.03 s, and µ is 1.7 times the largest |dF/dx| so far. As in that program both are computed at the slave, from the
scene's own force; nothing is added to the packets.
"""

from dataclasses import dataclass
from typing import ClassVar

from hapticnet.checks import check_above, check_parameter
from hapticnet.control.ports import Port
from hapticnet.samples import Vector
from hapticnet.vectors import along, minus
from hapticnet_literature.touch import Touch


class IssSlave:
    """The end of this coupling at the slave. Satisfies `ports.SlaveEnd`."""

    def __init__(self, port: Port, lead_s: float, scale: float) -> None:
        self._lead_s, self._scale = lead_s, scale
        self._touch = Touch(port.axes)

    def command(self, position_m: Vector, t_us: int, data: bytes) -> Vector:  # noqa: ARG002
        """Return the received position [m], less what the tool yields: x − F/µ."""
        touch = self._touch
        touch.step(t_us)
        stiffness = self._scale * touch.largest_stiffness
        touch.tool_m = along(position_m, -1.0 / stiffness, touch.force_n) if stiffness else position_m
        return touch.tool_m

    def answer(self, force_n: Vector) -> tuple[Vector, bytes]:
        """Return F + τ·dF/dt [N]."""
        change_n, elapsed_s = minus(force_n, self._touch.force_n), self._touch.elapsed_s
        self._touch.feel(force_n)
        return (along(force_n, self._lead_s / elapsed_s, change_n) if elapsed_s > 0.0 else force_n), b""


@dataclass(frozen=True, slots=True)
class Iss:
    """Add the rate of change to the force, and let the tool yield to it.

    Attributes
    ----------
    lead_s
        Weight τ of the force's rate of change [s].
    scale
        What the tool yields with: this times the largest stiffness so far.
    """

    name: ClassVar[str] = "iss"
    lead_s: float = 0.03
    scale: float = 1.7

    def __post_init__(self) -> None:
        check_parameter("lead of the force", self.lead_s, 0.0, 1.0, "s")
        check_above("scale of the stiffness", self.scale, 1.0, 1e6)

    def forward_bytes(self, axes: int) -> int:  # noqa: ARG002
        """Return that no data precedes a position."""
        return 0

    def feedback_bytes(self, axes: int) -> int:  # noqa: ARG002
        """Return that no data precedes a force."""
        return 0

    def master(self, port: Port) -> None:  # noqa: ARG002
        """Return that the master has no end."""
        return

    def slave(self, port: Port) -> IssSlave:
        """Return a new end at the slave."""
        return IssSlave(port, self.lead_s, self.scale)
