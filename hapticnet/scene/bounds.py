"""What a tissue can say about the force near the needle's tip (`StiffnessBound`)."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.scene.layer import Layer
from hapticnet.stiffness_bound import StiffnessBound

MARGIN_M: Final = 1e-9
"""How far [m] a box stays off a surface and off the depth at which one breaks: more than rounding amounts to."""

STIFFENED: Final = 1.25
"""By how much the stiffness of a tissue that stiffens grows, at most, from the tip to the deep side of a box."""


class Grip(NamedTuple):
    """What one layer adds: stiffness [N/m], damping [N·s/m], and the positions for which that is so [m]."""

    stiffness: float
    damping: float
    low_m: float
    high_m: float


def bound_of(felt: Sequence[Layer], passed: Sequence[Layer], ahead_m: float, tip_m: float) -> StiffnessBound | None:
    """Return the bound of a needle; None if a layer cannot tell.

    Parameters
    ----------
    felt, passed
        Layers that can exert a force at the tip, and those that heal when it is withdrawn.
    ahead_m
        Position of the next surface [m].
    """
    stiffness = damping = 0.0
    low_m = max((layer.surface.position_m() for layer in passed), default=-LARGEST_COMPONENT)
    high_m = ahead_m - MARGIN_M
    for layer in felt:
        grip = grip_of(layer, tip_m)
        if grip is None:
            return None
        stiffness += grip.stiffness
        damping += grip.damping
        low_m, high_m = max(low_m, grip.low_m), min(high_m, grip.high_m)
    if not low_m <= tip_m <= high_m:
        return None
    return StiffnessBound(stiffness, damping, (low_m,), (high_m,))


def grip_of(layer: Layer, tip_m: float) -> Grip | None:
    """Return what a layer that can exert a force adds at the tip; None if it cannot tell.

    The friction on a shaft depends on every turn of the hand, of which a line shows none. A surface that is still
    recovering meets the needle at a time, not at a position, which matters where there is a force for every speed.
    """
    tissue = layer.tissue
    if layer.breached:
        return Grip(0.0, 0.0, -LARGEST_COMPONENT, LARGEST_COMPONENT) if not layer.is_felt else None
    low_m, high_m = layer.rest_m, layer.rest_m + tissue.breach_depth_m - MARGIN_M
    if tissue.viscosity_n_s_per_m and layer.surface.position_m() > layer.rest_m + MARGIN_M:
        return None
    stiffness = tissue.stiffness_n_per_m
    growth = tissue.stiffening_per_m
    if growth:
        # dF/dx = k·exp(a·x): the box ends where that has grown by the factor, or shrunk by its square.
        step_m = math.log(STIFFENED) / growth
        low_m, high_m = max(low_m, tip_m - 2.0 * step_m), min(high_m, tip_m + step_m)
        stiffness *= math.exp(growth * (high_m - layer.rest_m))
    return Grip(stiffness, tissue.viscosity_n_s_per_m, low_m, high_m)
