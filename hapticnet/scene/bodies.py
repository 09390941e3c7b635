"""The scene of bodies: a tool on two or three axes against planes and spheres with friction.

Bodies act in parallel: the tool feels the sum, as with a lump in a soft body. The force of each is a spring's, plus
that of its viscosities. As everywhere, positions increase into the body, and a force is positive when it pushes
the tool out: the force of the spring is stiffness · (tool − held point).


The tool is joined to a point on the surface by a spring. While the spring is inside the cone of friction around the
normal at that point, the point sticks; otherwise it moves toward the tool until the spring lies on the cone. Zilles and
Salisbury, "A constraint-based god-object method for haptic display" (1995), render a surface by such a point; Ruspini,
Kolarov and Khatib, "The haptic display of complex graphical environments" (1997), model friction by moving it; Melder
and Harwin, "Force shading and bump mapping using the friction cone algorithm" (2005), name the cone.

A moving point approaches the tool, so the energy of the spring only falls: friction creates none. Nothing
is integrated, so the result for a tool that stays in one plane through the normal does not depend on the step; for a
turning tool, the result approaches the exact path in proportion to the step.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

from hapticnet.checks import axes_of
from hapticnet.errors import SampleError
from hapticnet.samples import ForceSample, PositionSample, Vector, checked_vector
from hapticnet.scene.ahead import REACH_M, LayerAhead
from hapticnet.scene.settings import LARGEST_SPEED_M_PER_S, AnyBody, BodySceneSettings, Contact, Plane, Sphere
from hapticnet.scene.shapes import Shape
from hapticnet.scene.vibration import Texture, Vibrations
from hapticnet.vectors import along, distance, dot, magnitude, minus, moved, over, plus, times

if TYPE_CHECKING:
    from hapticnet.scene.base import Vibrate

NEAR_M: Final = 1e-12  # distance [m] below which a direction is not computed from a difference of two points


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
        """Return the vector [m] from the nearest surface point to a tool at this depth."""
        return times(self._inward, depth_m)

    def entry(self, from_m: Vector, to_m: Vector) -> Vector:
        """Return the point where a straight line into the body meets the surface [m]."""
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
        """Return the vector [m] from the nearest surface point to a tool at this depth."""
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


LARGEST_FORCE_N: Final = 1e6
"""Largest magnitude of a force [N]. A body does not break, and a force must stay far within the range of numbers."""


class Touch:
    """A body and the point on it that the tool holds."""

    __slots__ = ("_held_m", "_in_time", "_static", "_surface", "_texture", "_touched", "body", "depth_m")

    def __init__(self, body: AnyBody) -> None:
        self.body = body
        self.depth_m = -math.inf  # how deep [m] the tool is; negative outside
        self._surface = surface_of(body)
        self._in_time = body.depends_on_time
        self._static = body.static_friction or body.friction
        self._held_m: Vector | None = None
        self._touched = False  # in the step before
        self._texture: Texture | None = None

    def force_n(self, tool_m: Vector, before_m: Vector | None, velocity_m_per_s: Vector) -> Vector | None:
        """Return the force [N] on a tool that has moved from `before_m`; None if it does not touch the body."""
        surface, body = self._surface, self.body
        self.depth_m = depth_m = surface.depth_m(tool_m)
        if depth_m <= 0.0:
            self._held_m = None
            return None
        if self._static:
            held_m = self._held_m
            if held_m is None:
                outside = before_m is not None and surface.depth_m(before_m) <= 0.0
                held_m = (
                    surface.entry(before_m, tool_m) if outside and before_m is not None else surface.nearest(tool_m)
                )
            self._held_m = held_m = surface.slide(held_m, tool_m, self._static, body.friction)
            stretch = minus(tool_m, held_m)
        else:
            stretch = surface.beyond(tool_m, depth_m)
        force_n = times(stretch, body.stiffness_n_per_m)
        if self._in_time:
            return self._damped(force_n, minus(tool_m, stretch), velocity_m_per_s)
        return force_n

    def _damped(self, force_n: Vector, held_m: Vector, velocity_m_per_s: Vector) -> Vector:
        """Add viscosity; along the normal at most to zero, so that the surface never holds the tool back."""
        inward = self._surface.inward(held_m)
        inward_m_per_s = dot(inward, velocity_m_per_s)
        sideways = along(velocity_m_per_s, -inward_m_per_s, inward)
        push_n = max(self.body.viscosity_n_s_per_m * inward_m_per_s, -dot(inward, force_n))
        return along(along(force_n, push_n, inward), self.body.sliding_viscosity_n_s_per_m, sideways)

    def vibrate(self, vibrations: Vibrations, t_us: int, elapsed_us: int, tool_m: Vector, before_m: Vector) -> None:
        """Let the body ring and its texture pass, after a step of the tool to `tool_m`."""
        body, touches = self.body, self.depth_m > 0.0
        if body.texture_m and self._texture is None:
            self._texture = Texture(body.texture_m, body.texture_per_s)
            vibrations.textures.append(self._texture)
        way = minus(tool_m, before_m)
        inward = self._surface.inward(self._surface.nearest(tool_m))
        if touches and not self._touched:
            vibrations.touch(t_us, elapsed_us, dot(way, inward), body)
        if self._texture is not None:
            along_m = magnitude(along(way, -dot(way, inward), inward)) if touches and self._touched else 0.0
            self._texture.slide(t_us, along_m)
        self._touched = touches

    def follow(self, other: "Touch") -> None:
        """Copy the state of another touch of the same body."""
        self.depth_m, self._held_m = other.depth_m, other._held_m

    def ahead(self, tool_m: Vector) -> LayerAhead:
        """Return the body's announcement to a tool at a position [m]: its tangent plane."""
        body, point_m = self.body, self._surface.nearest(tool_m)
        inward = self._surface.inward(point_m)
        return LayerAhead(
            dot(inward, point_m),
            body.stiffness_n_per_m,
            viscosity_n_s_per_m=body.viscosity_n_s_per_m,
            normal=inward,
        )


class BodyScene:
    """Bodies and a tool, advanced by position samples. Satisfies `scene.base.Touchable`.

    Time is taken from the samples only if a body depends on it. A stamp that repeats or goes back adds no time; the
    velocity is then zero.

    Raise SettingsError if there is no body, or bodies differ in their axes.
    """

    def __init__(self, bodies: Sequence[AnyBody], *, name: str = "scene") -> None:
        settings = BodySceneSettings(name=name, bodies=tuple(bodies))
        self.name = name
        self.axes = settings.axes
        self.bodies = settings.bodies
        self._in_time = any(body.depends_on_time for body in self.bodies)
        self.reset()

    def reset(self) -> None:
        """Take the tool away from all bodies."""
        self._vibrations = Vibrations() if any(body.ring_hz or body.texture_m for body in self.bodies) else None
        self.vibration: Vibrate | None = None if self._vibrations is None else self._vibrations.samples
        self._zero: Vector = (0.0,) * self.axes
        self._touches = [Touch(body) for body in self.bodies]
        self._tool_m: Vector | None = None
        self._stamp_us = 0

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force on a tool; SampleError, and no change, if its position is not finite or has other axes."""
        tool_m = checked_vector(sample.position_m, "position")
        if len(tool_m) != self.axes:
            raise SampleError(f"position has {axes_of(len(tool_m))}; the scene has {self.axes}")
        velocity_m_per_s = self._velocity(sample.t_us, tool_m) if self._in_time else self._zero
        total_n = self._zero
        for touch in self._touches:
            force_n = touch.force_n(tool_m, self._tool_m, velocity_m_per_s)
            if force_n is not None:
                total_n = plus(total_n, force_n)
            if self._vibrations is not None and self._tool_m is not None:
                touch.vibrate(self._vibrations, sample.t_us, sample.t_us - self._stamp_us, tool_m, self._tool_m)
        self._tool_m, self._stamp_us = tool_m, sample.t_us
        return ForceSample(sample.t_us, moved(self._zero, total_n, LARGEST_FORCE_N))

    @property
    def settings(self) -> BodySceneSettings:
        """Its settings."""
        return BodySceneSettings(name=self.name, bodies=self.bodies)

    def copy(self) -> "BodyScene":
        """Return a scene in the same state."""
        other = BodyScene(self.bodies, name=self.name)
        other._tool_m, other._stamp_us = self._tool_m, self._stamp_us
        for touch, mine in zip(other._touches, self._touches, strict=True):
            touch.follow(mine)
        other._vibrations = other.vibration = None  # what is only tried is not felt
        return other

    def contacts(self) -> tuple[Contact, ...]:
        """Return whether the tool touches each body."""
        return tuple(Contact.CONTACT if touch.depth_m > 0.0 else Contact.NONE for touch in self._touches)

    def depths_m(self) -> tuple[float, ...]:
        """Return how deep [m] the tool is in each body; negative outside."""
        return tuple(touch.depth_m for touch in self._touches)

    def shapes(self) -> tuple[Shape, ...]:
        """Return how the bodies look."""
        return tuple(
            Shape("plane", body.point_m, along=body.inward)
            if isinstance(body, Plane)
            else Shape("sphere", body.centre_m, (body.radius_m,))
            for body in self.bodies
        )

    def ahead(self) -> tuple[LayerAhead, ...]:
        """Return the bodies within `REACH_M` of the tool as planes, the nearest first. Friction is not announced."""
        if self._tool_m is None:
            return ()
        near = sorted(
            (touch for touch in self._touches if touch.depth_m >= -REACH_M), key=lambda touch: abs(touch.depth_m)
        )
        return tuple(touch.ahead(self._tool_m) for touch in near)

    def _velocity(self, t_us: int, tool_m: Vector) -> Vector:
        """Return the velocity [m/s] since the previous sample, at most `LARGEST_SPEED_M_PER_S`."""
        elapsed_us = t_us - self._stamp_us
        if self._tool_m is None or elapsed_us <= 0:
            return self._zero
        velocity = times(minus(tool_m, self._tool_m), 1e6 / elapsed_us)
        return moved(self._zero, velocity, LARGEST_SPEED_M_PER_S)
