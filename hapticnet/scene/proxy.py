"""The surface point that a tool holds: where it is, when it sticks, and where it slides to.

The tool is joined to a point on the surface by a spring. While the spring is inside the cone of friction around the
normal at that point, the point sticks; otherwise it moves toward the tool until the spring lies on the cone. Zilles and
Salisbury, "A constraint-based god-object method for haptic display" (1995), render a surface by such a point; Ruspini,
Kolarov and Khatib, "The haptic display of complex graphical environments" (1997), model friction by moving it; Melder
and Harwin, "Force shading and bump mapping using the friction cone algorithm" (2005), name the cone.

A point that moves comes nearer to the tool, so that the energy of the spring only falls: friction creates none. Nothing
is integrated, so the result for a tool that stays in one plane through the normal does not depend on the step; for a
tool that turns it approaches the exact path in proportion to the step.
"""

import math
from typing import Final, NamedTuple, TypeAlias

from hapticnet.samples import Vector
from hapticnet.scene.body import AnyBody, Plane, Sphere
from hapticnet.vectors import along, distance, dot, magnitude, minus, over, times

NEAR_M: Final = 1e-12
"""Distance [m] below which a direction is not computed from a difference of two points."""


class Tangent(NamedTuple):
    """A body near a position, as a plane: the force is stiffness · max(0, inward · position − offset) · inward.

    Attributes
    ----------
    inward
        Unit normal into the body.
    offset_m
        Distance of the plane from the origin along the normal [m].
    stiffness_n_per_m
        Force per depth [N/m].
    """

    inward: Vector
    offset_m: float
    stiffness_n_per_m: float


class FlatSurface:
    """The surface of a plane."""

    __slots__ = ("_inward", "_offset_m")

    def __init__(self, plane: Plane) -> None:
        self._inward = plane.inward
        self._offset_m = dot(plane.inward, plane.point_m)

    def depth_m(self, tool_m: Vector) -> float:
        """Return how deep [m] the tool is; negative outside."""
        return dot(self._inward, tool_m) - self._offset_m

    def inward(self, _point_m: Vector) -> Vector:
        """Return the unit normal into the body at a point of the surface."""
        return self._inward

    def nearest(self, tool_m: Vector) -> Vector:
        """Return the surface point [m] nearest to the tool."""
        return along(tool_m, -self.depth_m(tool_m), self._inward)

    def beyond(self, _tool_m: Vector, depth_m: float) -> Vector:
        """Return the way [m] from the nearest surface point to a tool that is so deep."""
        return times(self._inward, depth_m)

    def entry(self, from_m: Vector, to_m: Vector) -> Vector:
        """Return where a straight line into the body meets the surface [m]."""
        before_m, after_m = self.depth_m(from_m), self.depth_m(to_m)
        return self.nearest(along(from_m, before_m / (before_m - after_m), minus(to_m, from_m)))

    def slide(self, held_m: Vector, tool_m: Vector, static: float, friction: float) -> Vector:
        """Return the point [m] held after the tool has moved."""
        depth_m = self.depth_m(tool_m)
        nearest_m = along(tool_m, -depth_m, self._inward)
        stretch = minus(nearest_m, held_m)
        length_m = magnitude(stretch)
        if length_m <= static * depth_m:
            return held_m
        return along(nearest_m, -friction * depth_m / length_m, stretch)


class RoundSurface:
    """The surface of a sphere, touched from outside."""

    __slots__ = ("_centre_m", "_radius_m")

    def __init__(self, sphere: Sphere) -> None:
        self._centre_m = sphere.centre_m
        self._radius_m = sphere.radius_m

    def depth_m(self, tool_m: Vector) -> float:
        """Return how deep [m] the tool is; negative outside."""
        return self._radius_m - distance(tool_m, self._centre_m)

    def inward(self, point_m: Vector) -> Vector:
        """Return the unit normal into the body at a point of the surface, or at the centre's first axis."""
        return times(self._outward(point_m), -1.0)

    def nearest(self, tool_m: Vector) -> Vector:
        """Return the surface point [m] nearest to the tool."""
        return along(self._centre_m, self._radius_m, self._outward(tool_m))

    def beyond(self, tool_m: Vector, depth_m: float) -> Vector:
        """Return the way [m] from the nearest surface point to a tool that is so deep."""
        away_m = self._radius_m - depth_m
        if away_m < NEAR_M:
            return minus(tool_m, self.nearest(tool_m))
        return times(minus(self._centre_m, tool_m), depth_m / away_m)

    def entry(self, from_m: Vector, to_m: Vector) -> Vector:
        """Return where a straight line into the body meets the surface [m]."""
        way = minus(to_m, from_m)
        length_m = magnitude(way)
        direction = over(way, length_m)
        # The last metres are enough, and far away the squares below would lose the radius in rounding.
        back_m = min(length_m, 4.0 * self._radius_m)
        start = minus(along(to_m, -back_m, direction), self._centre_m)
        ahead_m = dot(start, direction)
        square = ahead_m * ahead_m - dot(start, start) + self._radius_m * self._radius_m
        travel_m = -ahead_m - math.sqrt(max(square, 0.0))
        return self.nearest(along(along(self._centre_m, 1.0, start), travel_m, direction))

    def slide(self, held_m: Vector, tool_m: Vector, static: float, friction: float) -> Vector:
        """Return the point [m] held after the tool has moved.

        In the triangle of centre, held point and tool, the angle at the held point is that of the cone when it slides;
        the law of sines gives the angle at the centre.
        """
        radius_m = self._radius_m
        away_m = distance(tool_m, self._centre_m)
        if away_m < NEAR_M:
            return held_m
        toward, held = self._outward(tool_m), self._outward(held_m)
        cosine = dot(toward, held)
        across = along(held, -cosine, toward)
        sine = magnitude(across)
        if away_m * sine <= static * (radius_m - away_m * cosine):
            return held_m
        cone = math.atan(friction)
        angle = math.asin(min(radius_m * math.sin(cone) / away_m, 1.0)) - cone
        if sine < NEAR_M:
            return self.nearest(tool_m)
        direction = along(times(toward, math.cos(angle)), math.sin(angle) / sine, across)
        return along(self._centre_m, radius_m, direction)

    def _outward(self, point_m: Vector) -> Vector:
        away = minus(point_m, self._centre_m)
        length_m = magnitude(away)
        if length_m < NEAR_M:
            return (-1.0, *(0.0,) * (len(away) - 1))
        return over(away, length_m)


Surface: TypeAlias = FlatSurface | RoundSurface


def surface_of(body: AnyBody) -> Surface:
    """Return the surface of a body."""
    return FlatSurface(body) if isinstance(body, Plane) else RoundSurface(body)
