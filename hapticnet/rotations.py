"""Rotations as unit quaternions and as rotation vectors, in plain tuples.

A rotation vector ``(rx, ry, rz)`` [rad] points along the axis and is as long as the angle, which may exceed a turn. A
quaternion is ``(x, y, z, w)``, the scalar last, as in ROS and SciPy; MuJoCo has it first. Both turn vectors in fixed
axes. Unless another source is named, formulas are those of Solà, "Quaternion kinematics for the error-state Kalman
filter" (2017), arXiv:1711.02508.
"""

import math
from typing import Final, TypeAlias

from hapticnet.samples import Vector
from hapticnet.vectors import dot, magnitude, over, times

Quaternion: TypeAlias = tuple[float, float, float, float]

NO_TURN: Final[Quaternion] = (0.0, 0.0, 0.0, 1.0)
ORIGIN: Final[Vector] = (0.0, 0.0, 0.0)
TINY: Final = 1e-9  # sine of half an angle below which rounding makes the axis of a quaternion of whole turns


def normalised(values: Vector) -> Quaternion:
    """Return the quaternion of length 1 in the direction of four numbers. ZeroDivisionError if all are zero."""
    x, y, z, w = values
    length = math.hypot(x, y, z, w)
    return x / length, y / length, z / length, w / length


def quaternion_of(vector: Vector) -> Quaternion:
    """Return the quaternion of a rotation vector [rad] (the exponential map)."""
    angle = magnitude(vector)
    share = math.sin(0.5 * angle) / angle if angle else 0.5
    x, y, z = vector
    return share * x, share * y, share * z, math.cos(0.5 * angle)


def vector_near(turn: Quaternion, last: Vector = ORIGIN) -> Vector:
    """Return the rotation vector [rad] of a quaternion of either sign: of the equal ones, the nearest to `last`.

    The logarithm, and as many whole turns as bring it nearest (Grassia, "Practical parameterization of rotations using
    the exponential map", 1998). Near `ORIGIN`, it is at most half a turn long.
    """
    x, y, z, w = turn
    along = (x, y, z)
    length = magnitude(along)
    if length < TINY and (turns := round(magnitude(last) / math.tau)):  # whole turns, around any axis
        return times(last, math.tau * turns / magnitude(last))
    if length == 0.0:
        return ORIGIN
    angle = 2.0 * math.atan2(length, w)
    angle += math.tau * round((dot(along, last) / length - angle) / math.tau)
    return times(along, angle / length)


def product(second: Quaternion, first: Quaternion) -> Quaternion:
    """Return the rotation that turns by `first`, then by `second` (Hamilton's product)."""
    a, b, c, d = second
    x, y, z, w = first
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )


def inverse(turn: Quaternion) -> Quaternion:
    """Return the opposite rotation (the conjugate)."""
    x, y, z, w = turn
    return -x, -y, -z, w


def rotated(vector: Vector, turn: Quaternion) -> Vector:
    """Return a vector of three axes after a rotation: with the quaternion's axis q, v + 2w q × v + 2 q × (q × v)."""
    a, b, c, w = turn
    x, y, z = vector
    u, v, s = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return x + w * u + b * s - c * v, y + w * v + c * u - a * s, z + w * s + a * v - b * u


def toward(turn: Quaternion, to: Quaternion, most_rad: float) -> Quaternion:
    """Return the rotation on the short way to another, at most `most_rad` [rad] away (Shoemake's slerp, 1985)."""
    away = vector_near(product(to, inverse(turn)))
    angle = magnitude(away)
    if angle <= most_rad:
        return to
    return normalised(product(quaternion_of(times(away, most_rad / angle)), turn))


def matrix_of(vector: Vector) -> tuple[Vector, Vector, Vector]:
    """Return the 3 x 3 matrix of a rotation vector [rad], by rows (Rodrigues' formula, 1840)."""
    angle = magnitude(vector)
    x, y, z = over(vector, angle) if angle else ORIGIN
    c, s = math.cos(angle), math.sin(angle)
    t = 1.0 - c
    return (
        (t * x * x + c, t * x * y - s * z, t * x * z + s * y),
        (t * x * y + s * z, t * y * y + c, t * y * z - s * x),
        (t * x * z - s * y, t * y * z + s * x, t * z * z + c),
    )
