"""Rotations as unit quaternions (x, y, z, w), in ROS's order, and rotation vectors [rad]."""

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

from hapticnet.samples import Vector

Quaternion: TypeAlias = tuple[float, float, float, float]

NO_TURN: Final[Quaternion] = (0.0, 0.0, 0.0, 1.0)
SHORTEST: Final = 1e-3  # length of a quaternion below which it is none


def normalised(values: Sequence[float]) -> Quaternion:
    """Return a quaternion of length 1 in the direction of four numbers, which are not all zero."""
    x, y, z, w = values
    length = math.hypot(x, y, z, w)
    return x / length, y / length, z / length, w / length


def turned_by(vector: Sequence[float]) -> Quaternion:
    """Return the quaternion of a rotation vector [rad]."""
    angle = math.hypot(*vector)
    share = math.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    x, y, z = vector
    return share * x, share * y, share * z, math.cos(0.5 * angle)


def vector_near(turn: Quaternion, last: Sequence[float]) -> Vector:
    """Return the rotation vector [rad] that is the nearest to `last`, of all those of a quaternion."""
    axis, length = turn[:3], math.hypot(*turn[:3])
    if length < 1e-9:  # whole turns, around any axis
        angle = math.hypot(*last)
        share = math.tau * round(angle / math.tau) / angle if angle > math.pi else 0.0
        return tuple([share * each for each in last])
    angle = 2.0 * math.atan2(length, turn[3])
    along = sum([each * before for each, before in zip(axis, last, strict=True)]) / length
    angle += math.tau * round((along - angle) / math.tau)
    return tuple([angle / length * each for each in axis])


def product(second: Quaternion, first: Quaternion) -> Quaternion:
    """Return the rotation that turns by `first`, then by `second`."""
    a, b, c, d = second
    x, y, z, w = first
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )


def inverse(turn: Quaternion) -> Quaternion:
    """Return the opposite rotation."""
    x, y, z, w = turn
    return -x, -y, -z, w


def rotated(vector: Sequence[float], turn: Quaternion) -> Vector:
    """Return a vector after a rotation."""
    x, y, z = vector
    return product(product(turn, (x, y, z, 0.0)), inverse(turn))[:3]


def toward(turn: Quaternion, to: Quaternion, most_rad: float) -> Quaternion:
    """Return the rotation between two that is at most `most_rad` [rad] away from the first, on the short way."""
    away = vector_near(product(to, inverse(turn)), (0.0, 0.0, 0.0))
    angle = math.hypot(*away)
    if angle <= most_rad:
        return to
    return normalised(product(turned_by([most_rad / angle * each for each in away]), turn))
