"""A stiffness bound as bytes, from the slave to the master: float32, big-endian.

Stiffness and damping come first, then the lower sides of the box, then the upper sides. An empty payload says that the
scene cannot tell how the force will change. Stiffness and damping are rounded up, the box inwards: what the master
reads promises no more than what the scene said.
"""

import struct
from collections.abc import Mapping
from typing import Final

import numpy as np

from hapticnet.errors import PeerError
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector
from hapticnet.stiffness_bound import StiffnessBound

LAYOUT: Final[Mapping[int, struct.Struct]] = {
    axes: struct.Struct(f">{2 + 2 * axes}f") for axes in range(1, MAX_AXES + 1)
}

STIFFEST: Final = 1e9
"""Largest stiffness [N/m] and damping [N·s/m]. Anything above is as good as no bound."""


def rounded_bound(bound: StiffnessBound | None) -> StiffnessBound | None:
    """Return a stiffness bound as the master reads it; None if there is none, or its numbers cannot be used."""
    if bound is None:
        return None
    stiffness, damping, low_m, high_m = bound
    rounded = StiffnessBound(
        _rounded(stiffness, np.inf),
        _rounded(damping, np.inf),
        tuple(_rounded(component, np.inf) for component in low_m),
        tuple(_rounded(component, -np.inf) for component in high_m),
    )
    return rounded if _is_good(rounded) else None


def pack_bound(bound: StiffnessBound | None) -> bytes:
    """Return the payload of a stiffness bound that is rounded."""
    if bound is None:
        return b""
    stiffness, damping, low_m, high_m = bound
    return LAYOUT[len(low_m)].pack(stiffness, damping, *low_m, *high_m)


def unpack_bound(payload: bytes, axes: int) -> StiffnessBound | None:
    """Return the bound in a payload; None if the scene cannot tell.

    Raises
    ------
    PeerError
        If the length is wrong, or a number is not finite or out of range.
    """
    if not payload:
        return None
    layout = LAYOUT[axes]
    if len(payload) != layout.size:
        raise PeerError(f"bound of {len(payload)} bytes; one of {axes} axes has {layout.size}")
    stiffness, damping, *sides = layout.unpack(payload)
    bound = StiffnessBound(stiffness, damping, tuple(sides[:axes]), tuple(sides[axes:]))
    if not _is_good(bound):
        raise PeerError(f"bound {tuple(bound)} is not what the protocol allows")
    return bound


def _is_good(bound: StiffnessBound) -> bool:
    stiffness, damping, low_m, high_m = bound
    return (
        0.0 <= stiffness <= STIFFEST
        and 0.0 <= damping <= STIFFEST
        and all(_is_side(low) and _is_side(high) and low <= high for low, high in zip(low_m, high_m, strict=True))
    )


def _is_side(component: float) -> bool:
    return abs(component) <= 2.0 * LARGEST_COMPONENT


def _rounded(x: float, toward: float) -> float:
    """Return the float32 nearest to a number that is not further from `toward`."""
    with np.errstate(over="ignore"):
        single = np.float32(x)
    if float(single) < x if toward > 0.0 else float(single) > x:  # numpy would compare them as float32
        single = np.nextafter(single, np.float32(toward))
    return float(single)


def box_around(position_m: Vector, radius_m: float) -> tuple[Vector, Vector]:
    """Return the sides of a box that reaches as far from a position on each axis [m]."""
    return tuple(x - radius_m for x in position_m), tuple(x + radius_m for x in position_m)
