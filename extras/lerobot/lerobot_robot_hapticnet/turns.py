"""Rotation vectors [rad] of a hand and a robot: one after the other."""

import math
from collections.abc import Sequence
from typing import Final

NO_TURN: Final = (0.0, 0.0, 0.0)


def composed(second: Sequence[float], first: Sequence[float], near: Sequence[float] = NO_TURN) -> tuple[float, ...]:
    """Return the rotation vector [rad] of `first` and then `second`: of the equal ones, the nearest to `near`.

    ``-v`` is the opposite of the rotation vector ``v``.
    """
    (a, b, c, d), (x, y, z, w) = _quaternion(second), _quaternion(first)
    axis = (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
    )
    length = math.hypot(*axis)
    if length < 1e-9:  # whole turns, around any axis
        angle = math.hypot(*near)
        share = math.tau * round(angle / math.tau) / angle if angle > math.pi else 0.0
        return tuple(share * each for each in near)
    angle = 2.0 * math.atan2(length, d * w - a * x - b * y - c * z)
    along = sum(each * other for each, other in zip(axis, near, strict=True)) / length
    angle += math.tau * round((along - angle) / math.tau)
    return tuple(angle / length * each for each in axis)


def difference(to: Sequence[float], start: Sequence[float]) -> tuple[float, ...]:
    """Return the rotation vector [rad] from one orientation to another, around fixed axes, on the short way."""
    return composed(to, [-each for each in start])


def _quaternion(vector: Sequence[float]) -> tuple[float, float, float, float]:
    angle = math.hypot(*vector)
    share = math.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    x, y, z = vector
    return share * x, share * y, share * z, math.cos(0.5 * angle)
