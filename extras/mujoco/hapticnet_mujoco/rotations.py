"""Rotations as unit quaternions (w, x, y, z) and rotation vectors [rad], in tuples: numpy is slower on four numbers."""

import math
from typing import TypeAlias

Triple: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

NO_TURN: Quaternion = (1.0, 0.0, 0.0, 0.0)


def turned_by(x: float, y: float, z: float) -> Quaternion:
    """Return the quaternion of a rotation vector [rad]."""
    angle = math.sqrt(x * x + y * y + z * z)
    scale = math.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    return math.cos(0.5 * angle), scale * x, scale * y, scale * z


def vector_of(quat: Quaternion) -> Triple:
    """Return the rotation vector [rad] of a quaternion, at most half a turn long."""
    w, x, y, z = quat if quat[0] >= 0.0 else tuple([-each for each in quat])
    length = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(length, w) / length if length > 1e-9 else 2.0
    return scale * x, scale * y, scale * z


def product(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the rotation that turns by `second`, then by `first`."""
    a, b, c, d = first
    w, x, y, z = second
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def inverse(quat: Quaternion) -> Quaternion:
    """Return the opposite rotation."""
    w, x, y, z = quat
    return w, -x, -y, -z


def rotated(vector: Triple, quat: Quaternion) -> Triple:
    """Return a vector after a rotation."""
    w, a, b, c = quat
    x, y, z = vector
    u, v, s = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return x + w * u + b * s - c * v, y + w * v + c * u - a * s, z + w * s + a * v - b * u
