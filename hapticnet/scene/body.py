"""Bodies that a tool touches and slides on, on two or three axes: shape, stiffness and friction."""

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

from hapticnet.checks import axes_of, check_parameter
from hapticnet.errors import SettingsError
from hapticnet.samples import MAX_AXES, Vector
from hapticnet.scene.tissue import LARGEST_VALUE, SMALLEST_VALUE, check_names

LARGEST_PLACE_M: Final = 10.0
"""Largest coordinate [m] of a body, and largest radius. Farther away, rounding would be felt on stiff bodies."""

SMALLEST_RADIUS_M: Final = 1e-4

LARGEST_FRICTION: Final = 10.0
"""Largest coefficient of friction; rubber on a rough surface reaches 2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """What planes and spheres have in common. Each property but the stiffness has no effect, and no cost, at zero.

    Attributes
    ----------
    name
        Name of the body.
    stiffness_n_per_m
        Force per distance [N/m] between the tool and the surface point that it holds.
    viscosity_n_s_per_m
        Force per speed [N·s/m] along the normal during contact. It never makes the surface hold the tool back.
    friction
        Coulomb's coefficient of sliding friction (dimensionless).
    static_friction
        Coefficient that the ratio of tangential to normal force must exceed before the tool slides; 0: as `friction`.
        A greater one lets a slow tool stick and slip.
    sliding_viscosity_n_s_per_m
        Force per speed [N·s/m] along the surface during contact.

    Raises
    ------
    SettingsError
        If a value is not finite or out of range.
    """

    name: str
    stiffness_n_per_m: float
    viscosity_n_s_per_m: float = 0.0
    friction: float = 0.0
    static_friction: float = 0.0
    sliding_viscosity_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        where = f"body {self.name!r}:"
        check_parameter(f"{where} stiffness_n_per_m", self.stiffness_n_per_m, SMALLEST_VALUE, LARGEST_VALUE)
        for key in ("viscosity_n_s_per_m", "sliding_viscosity_n_s_per_m"):
            check_parameter(f"{where} {key}", getattr(self, key), SMALLEST_VALUE, LARGEST_VALUE, zero_allowed=True)
        check_parameter(f"{where} friction", self.friction, SMALLEST_VALUE, LARGEST_FRICTION, zero_allowed=True)
        check_parameter(
            f"{where} static_friction", self.static_friction, self.friction, LARGEST_FRICTION, zero_allowed=True
        )

    @property
    def depends_on_time(self) -> bool:
        """Whether the force depends on the time of the motion, not only on the position."""
        return self.viscosity_n_s_per_m > 0.0 or self.sliding_viscosity_n_s_per_m > 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane(Body):
    """All that lies beyond a plane; on two axes, beyond a line.

    Attributes
    ----------
    point_m
        A point [m] of the plane, one coordinate for each axis.
    inward
        Direction into the body; scaled to length 1.
    """

    point_m: Vector
    inward: Vector

    def __post_init__(self) -> None:
        super(Plane, self).__post_init__()
        object.__setattr__(self, "point_m", _place(f"body {self.name!r}: point_m", self.point_m))
        inward = _place(f"body {self.name!r}: inward", self.inward)
        length = math.hypot(*inward)
        if length < SMALLEST_VALUE:
            raise SettingsError(f"body {self.name!r}: inward is {list(inward)}; it must have a direction")
        if len(inward) != len(self.point_m):
            raise SettingsError(
                f"body {self.name!r}: inward has {len(inward)} coordinates and point_m {len(self.point_m)};"
                " they must have as many"
            )
        object.__setattr__(self, "inward", tuple(each / length for each in inward))

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.point_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(Body):
    """A sphere that is touched from outside; on two axes, a disc.

    Attributes
    ----------
    centre_m
        Its centre [m], one coordinate for each axis.
    radius_m
        Its radius [m].
    """

    centre_m: Vector
    radius_m: float

    def __post_init__(self) -> None:
        super(Sphere, self).__post_init__()
        object.__setattr__(self, "centre_m", _place(f"body {self.name!r}: centre_m", self.centre_m))
        check_parameter(f"body {self.name!r}: radius_m", self.radius_m, SMALLEST_RADIUS_M, LARGEST_PLACE_M)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.centre_m)


AnyBody: TypeAlias = Plane | Sphere


@dataclass(frozen=True, slots=True, kw_only=True)
class BodySceneSettings:
    """A scene's name and its bodies.

    Raises
    ------
    SettingsError
        If there is no body, two have different numbers of axes, or a name is not unique or does not fit a message.
    """

    name: str
    bodies: tuple[AnyBody, ...]

    def __post_init__(self) -> None:
        if not self.bodies:
            raise SettingsError("the scene has no body; it must have at least one")
        first = self.bodies[0]
        for body in self.bodies:
            if body.axes != first.axes:
                raise SettingsError(
                    f"body {first.name!r} has {axes_of(first.axes)} and body {body.name!r} {body.axes};"
                    " all bodies of a scene must have as many"
                )
        check_names(self.name, [body.name for body in self.bodies], "bodies")

    @property
    def axes(self) -> int:
        """Number of axes of positions and forces."""
        return self.bodies[0].axes


def _place(name: str, values: object) -> Vector:
    """Return two or three checked coordinates."""
    if not isinstance(values, (list, tuple)) or not 2 <= len(values) <= MAX_AXES:
        raise SettingsError(f"{name} is {values!r}; it must be 2 or {MAX_AXES} numbers")
    for value in values:
        check_parameter(name, value, -LARGEST_PLACE_M, LARGEST_PLACE_M)
    return tuple(map(float, values))
