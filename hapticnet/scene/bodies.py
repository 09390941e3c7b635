"""The scene of bodies: a tool on two or three axes against planes and spheres with friction.

Bodies act in parallel: the tool feels the sum, as of a lump in a soft body. The force of each is that of a spring, plus
what its viscosities add; `scene.proxy` has the rule of friction. As everywhere, a position grows into what is touched,
and a force is positive when it pushes the tool out: the force of the spring is stiffness · (tool − held point).
"""

import math
from collections.abc import Sequence
from typing import Final

from hapticnet.checks import axes_of
from hapticnet.errors import SampleError
from hapticnet.samples import ForceSample, PositionSample, Vector, checked_vector
from hapticnet.scene.ahead import REACH_M, LayerAhead
from hapticnet.scene.body import AnyBody, BodySceneSettings
from hapticnet.scene.needle import LARGEST_SPEED_M_PER_S
from hapticnet.scene.proxy import Tangent, surface_of
from hapticnet.scene.tissue import Contact
from hapticnet.vectors import along, dot, minus, moved, plus, times

LARGEST_FORCE_N: Final = 1e6
"""Largest magnitude of a force [N]. A body does not break, and a force must stay far within what numbers can hold."""


class Touch:
    """A body and what the tool holds of it.

    Attributes
    ----------
    body
        The body.
    depth_m
        How deep [m] the tool is; negative outside.
    """

    __slots__ = ("_held_m", "_in_time", "_static", "_surface", "body", "depth_m")

    def __init__(self, body: AnyBody) -> None:
        self.body = body
        self.depth_m = -math.inf
        self._surface = surface_of(body)
        self._in_time = body.depends_on_time
        self._static = body.static_friction or body.friction
        self._held_m: Vector | None = None

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

    def tangent(self, tool_m: Vector) -> Tangent:
        """Return the plane that touches the body where it is nearest to the tool."""
        point_m = self._surface.nearest(tool_m)
        inward = self._surface.inward(point_m)
        return Tangent(inward, dot(inward, point_m), self.body.stiffness_n_per_m)

    def _damped(self, force_n: Vector, held_m: Vector, velocity_m_per_s: Vector) -> Vector:
        """Add viscosity; along the normal no further than to zero, so that the surface never holds the tool back."""
        inward = self._surface.inward(held_m)
        inward_m_per_s = dot(inward, velocity_m_per_s)
        sideways = along(velocity_m_per_s, -inward_m_per_s, inward)
        push_n = max(self.body.viscosity_n_s_per_m * inward_m_per_s, -dot(inward, force_n))
        return along(along(force_n, push_n, inward), self.body.sliding_viscosity_n_s_per_m, sideways)

    def ahead(self, tool_m: Vector) -> LayerAhead:
        """Return the body as it is announced to a tool at a position [m]: as its tangent plane."""
        plane = self.tangent(tool_m)
        return LayerAhead(
            plane.offset_m,
            plane.stiffness_n_per_m,
            viscosity_n_s_per_m=self.body.viscosity_n_s_per_m,
            normal=plane.inward,
        )


class BodyScene:
    """Bodies and a tool, advanced by position samples. Satisfies `scene.base.Touchable`.

    Time is taken from the samples only if a body depends on it. A stamp that repeats or goes back adds no time; the
    velocity is then zero.

    Parameters
    ----------
    bodies
        Planes and spheres with as many axes.
    name
        Name of the scene.

    Attributes
    ----------
    axes
        Number of axes of positions and forces.
    bodies
        The bodies.

    Raises
    ------
    SettingsError
        If there is no body, or bodies differ in their axes.
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
        self._zero: Vector = (0.0,) * self.axes
        self._touches = [Touch(body) for body in self.bodies]
        self._tool_m: Vector | None = None
        self._stamp_us = 0

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force on a tool at `sample`.

        Raises
        ------
        SampleError
            If the position is not finite or has another number of axes; the scene does not change.
        """
        tool_m = checked_vector(sample.position_m, "position")
        if len(tool_m) != self.axes:
            raise SampleError(f"position has {axes_of(len(tool_m))}; the scene has {self.axes}")
        velocity_m_per_s = self._velocity(sample.t_us, tool_m) if self._in_time else self._zero
        total_n = self._zero
        for touch in self._touches:
            force_n = touch.force_n(tool_m, self._tool_m, velocity_m_per_s)
            if force_n is not None:
                total_n = plus(total_n, force_n)
        self._tool_m, self._stamp_us = tool_m, sample.t_us
        return ForceSample(sample.t_us, moved(self._zero, total_n, LARGEST_FORCE_N))

    def contacts(self) -> tuple[Contact, ...]:
        """Return whether the tool touches each body."""
        return tuple(Contact.CONTACT if touch.depth_m > 0.0 else Contact.NONE for touch in self._touches)

    def depths_m(self) -> tuple[float, ...]:
        """Return how deep [m] the tool is in each body; negative outside."""
        return tuple(touch.depth_m for touch in self._touches)

    def tangents(self, position_m: Vector) -> tuple[Tangent, ...]:
        """Return each body near a position [m] as a plane."""
        return tuple(touch.tangent(position_m) for touch in self._touches)

    def ahead(self) -> tuple[LayerAhead, ...]:
        """Return the bodies within `REACH_M` of the tool as planes, the nearest first. Friction is not announced."""
        if self._tool_m is None:
            return ()
        near = sorted(
            (touch for touch in self._touches if touch.depth_m >= -REACH_M), key=lambda touch: abs(touch.depth_m)
        )
        return tuple(touch.ahead(self._tool_m) for touch in near)

    def _velocity(self, t_us: int, tool_m: Vector) -> Vector:
        """Return the velocity [m/s] since the sample before, at most `LARGEST_SPEED_M_PER_S`."""
        elapsed_us = t_us - self._stamp_us
        if self._tool_m is None or elapsed_us <= 0:
            return self._zero
        velocity = times(minus(tool_m, self._tool_m), 1e6 / elapsed_us)
        return moved(self._zero, velocity, LARGEST_SPEED_M_PER_S)
