"""A position and a velocity: the line that the master promises to stay near, and its payload.

======= =========== ========= ==============================
B/axis  position    velocity  used
======= =========== ========= ==============================
4       float32     none      if the velocity rounds to zero
6       float32     float16   otherwise
======= =========== ========= ==============================

Big-endian; positions of all axes come first. Velocities are in m/s.
"""

import math
import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

from hapticnet.codec.payload.values import SINGLE
from hapticnet.errors import PeerError
from hapticnet.rounding import as_half
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector
from hapticnet.stiffness_bound import LONGEST_SILENCE_US
from hapticnet.vectors import along, in_range, limited

HALF: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}e") for axes in range(1, MAX_AXES + 1)}

FASTEST_M_PER_S: Final = 10.0
"""Largest velocity of a line on an axis: several times that of a hand (as in `scene.needle`)."""


class PromisedLine(NamedTuple):
    """Where the master says that its tool is: at a position, moving on at a velocity.

    Attributes
    ----------
    t_us
        Time of the position [µs].
    position_m, velocity_m_per_s
        As both sides know them, rounded for the wire.
    """

    t_us: int
    position_m: Vector
    velocity_m_per_s: Vector

    def at(self, t_us: int) -> Vector:
        """Return the position on the line at a time [m]: level before it starts and after `LONGEST_SILENCE_US`."""
        elapsed_us = min(t_us - self.t_us, LONGEST_SILENCE_US)
        if elapsed_us <= 0:
            return self.position_m
        return limited(along(self.position_m, 1e-6 * elapsed_us, self.velocity_m_per_s), LARGEST_COMPONENT)


def as_velocity(velocity_m_per_s: Vector) -> Vector:
    """Return a velocity as it is rounded for the wire, limited to ± `FASTEST_M_PER_S` on each axis."""
    return tuple(as_half(component) + 0.0 for component in limited(velocity_m_per_s, FASTEST_M_PER_S))


def pack_line(line: PromisedLine) -> bytes:
    """Return the payload of a line."""
    position_m, velocity_m_per_s = line.position_m, line.velocity_m_per_s
    payload = SINGLE[len(position_m)].pack(*position_m)
    if any(velocity_m_per_s):
        payload += HALF[len(velocity_m_per_s)].pack(*velocity_m_per_s)
    return payload


def unpack_line(t_us: int, payload: bytes, axes: int) -> PromisedLine:
    """Return the line in the payload of a POSITION.

    Raises
    ------
    PeerError
        If the length fits no form, or a component is not finite or out of range.
    """
    size = 4 * axes
    if len(payload) not in (size, 6 * axes):
        raise PeerError(f"payload of {len(payload)} bytes; a line of {axes} axes has {size} or {6 * axes}")
    position_m: Vector = SINGLE[axes].unpack(payload[:size])
    velocity_m_per_s: Vector = HALF[axes].unpack(payload[size:]) if len(payload) > size else (0.0,) * axes
    if not in_range(position_m):
        raise PeerError(f"payload holds the position {position_m} m; it must be within ±{LARGEST_COMPONENT:g}")
    if not all(math.isfinite(speed) and abs(speed) <= FASTEST_M_PER_S for speed in velocity_m_per_s):
        raise PeerError(f"payload holds a velocity of {velocity_m_per_s} m/s; it must be within ±{FASTEST_M_PER_S:g}")
    return PromisedLine(t_us, position_m, velocity_m_per_s)
