"""Two masters hold one box, and each feels what the other does: the right one sees its axis from the other side.

slave:  hapticnet slave --scene examples/shared_box.py:Side
left:   hapticnet master --name left --operator examples/shared_box.py:Push:by_m=0.005
right:  hapticnet master --name right --operator examples/shared_box.py:Push
"""

from math import sin
from types import SimpleNamespace

from hapticnet.samples import PositionSample

BOX = SimpleNamespace(centre_m=0.1, speed_m_per_s=0.0, pushes_n={})  # what every object of this class touches
HALF_M, STIFFNESS_N_PER_M, MASS_KG, DAMPING_N_S_PER_M = 0.05, 400.0, 0.3, 4.0


class Side:
    """One side of the box. Each master gets a new object, and `welcome` tells it the name of its master."""

    def welcome(self, master: str) -> None:
        """Remember the master; an exception refuses it."""
        if master not in ("left", "right"):
            raise ValueError(f"the box has no side {master!r}; start the master with --name left or --name right")
        self.side, self.t_us = master, 0

    def step(self, sample: PositionSample) -> float:
        """Return the force [N]; the steps of one of the masters also move the box."""
        surface_m = BOX.centre_m - HALF_M if self.side == "left" else 0.2 - BOX.centre_m - HALF_M
        BOX.pushes_n[self.side] = max(0.0, STIFFNESS_N_PER_M * (sample.position_m[0] - surface_m))
        elapsed_s, self.t_us = 1e-6 * min(sample.t_us - self.t_us, 2000), sample.t_us
        if self.side == min(BOX.pushes_n):
            pushed_n = BOX.pushes_n.get("left", 0.0) - BOX.pushes_n.get("right", 0.0)
            BOX.speed_m_per_s += elapsed_s * (pushed_n - DAMPING_N_S_PER_M * BOX.speed_m_per_s) / MASS_KG
            BOX.centre_m += elapsed_s * BOX.speed_m_per_s
        return float(BOX.pushes_n[self.side])


def Push(by_m: float = 0.0) -> SimpleNamespace:  # noqa: N802 - named as a class on the command line
    """Return a hand that presses 5 mm into the box, give or take `by_m`."""
    return SimpleNamespace(sample=lambda t_us: 0.055 + by_m * sin(2e-6 * t_us))
