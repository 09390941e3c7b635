"""Vectors of 1 to 3 floats, as tuples: numpy costs tens of microseconds on a single sample.

Every function runs as plain Python on the path of a sample and is compiled for whole recordings (`compiled`). The
number of axes is decided when it is compiled, so that each case is straight-line code.

Norms are plain roots of sums of squares, not `math.hypot`, which rounds differently on different machines. Differences
below 1e-154 therefore count as zero on two and three axes.
"""

import math
from collections.abc import MutableSequence, Sequence

from hapticnet.rounding import as_single
from hapticnet.samples import LARGEST_COMPONENT, Vector


def magnitude(x: Vector) -> float:
    """Return the Euclidean norm of a vector."""
    if len(x) == 1:
        return abs(x[0])
    if len(x) == 2:
        return math.sqrt(x[0] * x[0] + x[1] * x[1])
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


def distance(x: Vector, y: Vector) -> float:
    """Return the Euclidean norm of the difference of two vectors."""
    if len(x) == 1:
        return abs(x[0] - y[0])
    if len(x) == 2:
        return math.sqrt((x[0] - y[0]) * (x[0] - y[0]) + (x[1] - y[1]) * (x[1] - y[1]))
    a, b, c = x[0] - y[0], x[1] - y[1], x[2] - y[2]
    return math.sqrt(a * a + b * b + c * c)


def dot(x: Vector, y: Vector) -> float:
    """Return the inner product of two vectors."""
    if len(x) == 1:
        return x[0] * y[0]
    if len(x) == 2:
        return x[0] * y[0] + x[1] * y[1]
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def plus(x: Vector, y: Vector) -> Vector:
    """Return x + y."""
    if len(x) == 1:
        return (x[0] + y[0],)
    if len(x) == 2:
        return x[0] + y[0], x[1] + y[1]
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


def minus(x: Vector, y: Vector) -> Vector:
    """Return x - y."""
    if len(x) == 1:
        return (x[0] - y[0],)
    if len(x) == 2:
        return x[0] - y[0], x[1] - y[1]
    return x[0] - y[0], x[1] - y[1], x[2] - y[2]


def times(x: Vector, s: float) -> Vector:
    """Return x · s."""
    if len(x) == 1:
        return (x[0] * s,)
    if len(x) == 2:
        return x[0] * s, x[1] * s
    return x[0] * s, x[1] * s, x[2] * s


def over(x: Vector, s: float) -> Vector:
    """Return x / s."""
    if len(x) == 1:
        return (x[0] / s,)
    if len(x) == 2:
        return x[0] / s, x[1] / s
    return x[0] / s, x[1] / s, x[2] / s


def along(x: Vector, s: float, y: Vector) -> Vector:
    """Return x + s · y."""
    if len(x) == 1:
        return (x[0] + s * y[0],)
    if len(x) == 2:
        return x[0] + s * y[0], x[1] + s * y[1]
    return x[0] + s * y[0], x[1] + s * y[1], x[2] + s * y[2]


def moved(x: Vector, by: Vector, limit: float) -> Vector:
    """Return x + by, or the point in that direction whose distance from x is the limit, if that is nearer."""
    length = magnitude(by)
    return along(x, limit / length if length > limit else 1.0, by)


def within(x: float, limit: float) -> float:
    """Return a number limited to ± limit."""
    if x > limit:
        return limit
    return -limit if x < -limit else x


def limited(x: Vector, limit: float) -> Vector:
    """Return a vector whose components are limited to ± limit."""
    if len(x) == 1:
        return (within(x[0], limit),)
    if len(x) == 2:
        return within(x[0], limit), within(x[1], limit)
    return within(x[0], limit), within(x[1], limit), within(x[2], limit)


def largest_component(x: Vector) -> float:
    """Return the largest magnitude of a component."""
    if len(x) == 1:
        return abs(x[0])
    if len(x) == 2:
        return max(abs(x[0]), abs(x[1]))
    return max(abs(x[0]), abs(x[1]), abs(x[2]))


def in_range(x: Vector) -> bool:
    """Return whether every component is finite and within ± `LARGEST_COMPONENT`."""
    # Written so that NaN, which compares false with everything, is out of range.
    if len(x) == 1:
        return abs(x[0]) <= LARGEST_COMPONENT
    if len(x) == 2:
        return abs(x[0]) <= LARGEST_COMPONENT and abs(x[1]) <= LARGEST_COMPONENT
    return abs(x[0]) <= LARGEST_COMPONENT and abs(x[1]) <= LARGEST_COMPONENT and abs(x[2]) <= LARGEST_COMPONENT


def single(x: Vector) -> Vector:
    """Return a vector whose components are rounded to float32."""
    if len(x) == 1:
        return (as_single(x[0]),)
    if len(x) == 2:
        return as_single(x[0]), as_single(x[1])
    return as_single(x[0]), as_single(x[1]), as_single(x[2])


def row(rows: Sequence[Sequence[float]], index: int, like: Vector) -> Vector:
    """Return a row of a table as a vector of as many axes as `like` has."""
    if len(like) == 1:
        return (rows[index][0],)
    if len(like) == 2:
        return rows[index][0], rows[index][1]
    return rows[index][0], rows[index][1], rows[index][2]


def put(rows: Sequence[MutableSequence[float]], index: int, x: Vector) -> None:
    """Write a vector to a row of a table."""
    rows[index][0] = x[0]
    if len(x) >= 2:
        rows[index][1] = x[1]
    if len(x) == 3:
        rows[index][2] = x[2]
