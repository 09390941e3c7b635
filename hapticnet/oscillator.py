"""The exact motion of a mass on a spring and a damper, for hands and followers of every mass, stiffness and rate."""

import math
from typing import NamedTuple


class Step(NamedTuple):
    """The exact step of mass, damper and spring over a time: x' = xx x + xv v + xf F, v' = vx x + vv v + vf F."""

    xx: float
    xv: float
    xf: float
    vx: float
    vv: float
    vf: float


def exact_step(mass_kg: float, damping: float, stiffness: float, step_s: float) -> Step:
    """Return the solution of M x'' + B x' + K x = F over a time [s] in which F [N] is constant; K is above zero."""
    middle, squared = -0.5 * damping / mass_kg, stiffness / mass_kg  # sum of the roots / 2, and their product
    apart = middle * middle - squared
    if apart > 0.0:
        fast = middle - math.sqrt(apart)
        slow = squared / fast  # not by a difference, which cancels for a small mass
        e_slow, e_fast = math.exp(slow * step_s), math.exp(fast * step_s)
        between = slow - fast
        xv = (e_slow - e_fast) / between if between * step_s > 1e-6 else step_s * e_slow
        xx = e_slow - slow * xv
        vv = e_fast + slow * xv
    else:
        turn = math.sqrt(-apart)
        decay = math.exp(middle * step_s)
        xv = decay * (math.sin(turn * step_s) / turn if turn * step_s > 1e-6 else step_s)
        xx = decay * math.cos(turn * step_s) - middle * xv
        vv = decay * math.cos(turn * step_s) + middle * xv
    return Step(xx, xv, (1.0 - xx) / stiffness, -squared * xv, vv, xv / mass_kg)
