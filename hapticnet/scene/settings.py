"""The parts of scenes: layers of tissue on one axis, or bodies with friction on two or three."""

import enum
import itertools
import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from hapticnet.checks import axes_of, check_parameter
from hapticnet.errors import SettingsError
from hapticnet.samples import MAX_AXES, Vector

SMALLEST_VALUE: Final = 1e-9
"""Smallest nonzero value [SI units] of a property; below it, floating-point precision runs out."""

LARGEST_VALUE: Final = 1e6
"""Largest value [SI units] of a property. A stiffness of 1e6 N/m is bone or steel, not tissue."""

LARGEST_SPEED_M_PER_S: Final = 10.0
"""Limit of the tip's speed [m/s]; two samples with nearly equal time stamps would give an unbounded one.

An assumption: several times the speed of a hand that inserts a needle.
"""

LARGEST_EXPONENT: Final = 700.0  # `math.expm1` overflows above 709; at this exponent the force exceeds any breach force
LONGEST_NAME: Final = 64  # largest size [bytes of UTF-8] of a name, limited by the protocol's WELCOME message


class Contact(enum.IntEnum):
    """Contact of the needle with one tissue."""

    NONE = 0
    CONTACT = 1
    PENETRATED = 2


LARGEST_RING_M_S2: Final = 1000.0  # largest amplitude [m/s²] of a vibration
LARGEST_RING_HZ: Final = 1000.0  # highest frequency that is transmitted


def check_ring(where: str, of: "Tissue | Body") -> None:
    """Raise SettingsError if the frequency, the decay or the touch of a ring is invalid."""
    check_parameter(f"{where} ring_hz", of.ring_hz, 1.0, LARGEST_RING_HZ, "Hz", zero_allowed=True)
    check_parameter(f"{where} ring_decay_per_s", of.ring_decay_per_s, 1.0, 1e4, "1/s")
    check_parameter(f"{where} touch_per_s", of.touch_per_s, 0.0, LARGEST_VALUE, "1/s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tissue:
    """One layer of tissue, described by its surface.

    The first four properties describe the tissue of "Cutaneous haptic deadband compression": a spring that breaks.
    Each of the others has no effect, and no cost, while it is zero.
    """

    name: str
    rest_position_m: float  # position [m] of the undisturbed surface; it increases into the body
    stiffness_n_per_m: float  # force per indentation [N/m]; the stiffness at the surface if the tissue stiffens
    breach_force_n: float  # elastic force [N] above which the needle pierces the surface
    viscosity_n_s_per_m: float = 0.0  # force per speed [N·s/m] while the surface is indented
    shaft_friction_n: float = 0.0  # friction [N] of the pierced tissue on the needle's shaft
    # Distance [m] over which the tissue is dragged along before the shaft slides; used with `shaft_friction_n`. The
    # default is an assumption.
    shaft_presliding_m: float = 0.5e-3
    stiffening_per_m: float = 0.0  # relative growth of stiffness with indentation [1/m]
    # Time constant [s] with which a pierced surface returns to its rest position; zero: it returns at once
    recovery_time_s: float = 0.0
    # What vibrates at the first touch and at a breach (`scene.vibration`): frequency, decay, amplitude per speed [m/s]
    # of the touch, and amplitude of the breach
    ring_hz: float = 0.0
    ring_decay_per_s: float = 80.0
    touch_per_s: float = 0.0
    breach_m_s2: float = 0.0

    def __post_init__(self) -> None:
        where = f"tissue {self.name!r}:"
        check_parameter(f"{where} rest_position_m", self.rest_position_m, -LARGEST_VALUE, LARGEST_VALUE)
        for key in ("stiffness_n_per_m", "breach_force_n", "shaft_presliding_m"):
            check_parameter(f"{where} {key}", getattr(self, key), SMALLEST_VALUE, LARGEST_VALUE)
        for key in ("viscosity_n_s_per_m", "shaft_friction_n", "stiffening_per_m", "recovery_time_s"):
            check_parameter(f"{where} {key}", getattr(self, key), SMALLEST_VALUE, LARGEST_VALUE, zero_allowed=True)
        check_parameter(f"{where} breach_m_s2", self.breach_m_s2, 0.0, LARGEST_RING_M_S2, "m/s²")
        check_ring(where, self)

    @property
    def breach_depth_m(self) -> float:
        """Indentation [m] at which the elastic force reaches the breach force."""
        depth_m = self.breach_force_n / self.stiffness_n_per_m
        if self.stiffening_per_m:
            return math.log1p(self.stiffening_per_m * depth_m) / self.stiffening_per_m
        return depth_m

    @property
    def depends_on_time(self) -> bool:
        """Whether the force depends on the time of the motion, not only on the position."""
        return self.viscosity_n_s_per_m > 0.0 or self.recovery_time_s > 0.0


def front_to_back(tissues: Sequence[Tissue]) -> tuple[Tissue, ...]:
    """Return the tissues as a needle meets them; SettingsError if there is none, or if two share a rest position."""
    if not tissues:
        raise SettingsError("the scene has no tissue; it must have at least one")
    ordered = sorted(tissues, key=lambda tissue: tissue.rest_position_m)
    for front, back in itertools.pairwise(ordered):
        if front.rest_position_m == back.rest_position_m:
            raise SettingsError(
                f"tissues {front.name!r} and {back.name!r} both rest at {front.rest_position_m} m; "
                "there must be a gap between two tissues"
            )
    return tuple(ordered)


def check_names(scene: str, names: Sequence[str], what: str) -> None:
    """Check the names of a scene and its parts; raise SettingsError if one is not unique or does not fit a message."""
    for name in (scene, *names):
        if not name.isprintable() or not 0 < len(name.encode()) <= LONGEST_NAME:
            raise SettingsError(
                f"name {reprlib.repr(name)} has {len(name.encode())} bytes; names are 1 to {LONGEST_NAME} bytes of"
                " printable characters"
            )
        if names.count(name) > 1:
            raise SettingsError(f"{names.count(name)} {what} are called {name!r}; names must be unique")


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowerSettings:
    """A mass that a PD or PID controller moves to the received position, and that touches the scene instead."""

    mass_kg: float
    stiffness_n_per_m: float  # force of the controller per distance from the received position
    damping_n_s_per_m: float  # and per difference from its velocity
    integral_n_per_m_s: float = 0.0  # and per distance and time
    force: Literal["contact", "controller"] = "contact"  # the force that answers the position

    def __post_init__(self) -> None:
        check_parameter("follower: mass_kg", self.mass_kg, 1e-6, 100.0)
        check_parameter("follower: stiffness_n_per_m", self.stiffness_n_per_m, 1.0, LARGEST_VALUE)
        check_parameter("follower: damping_n_s_per_m", self.damping_n_s_per_m, 1e-3, LARGEST_VALUE)
        most = self.damping_n_s_per_m * self.stiffness_n_per_m / self.mass_kg
        if not 0.0 <= self.integral_n_per_m_s < most:
            raise SettingsError(
                f"follower: integral_n_per_m_s is {self.integral_n_per_m_s}; it must be 0 or greater, and below damping"
                f" times stiffness over mass, {most:g}, or the follower oscillates by itself"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSettings:
    """A scene's name and its tissues, sorted from front to back."""

    name: str
    tissues: tuple[Tissue, ...]
    follower: FollowerSettings | None = None  # None: the received position itself touches the scene

    def __post_init__(self) -> None:
        object.__setattr__(self, "tissues", front_to_back(self.tissues))
        check_names(self.name, [tissue.name for tissue in self.tissues], "tissues")

    @property
    def stiffest_n_per_m(self) -> float:
        """Largest stiffness of a tissue before it breaks."""
        return max(each.stiffness_n_per_m + each.stiffening_per_m * each.breach_force_n for each in self.tissues)


LARGEST_PLACE_M: Final = 10.0
"""Largest coordinate [m] of a body, and largest radius. Farther away, rounding would be felt on stiff bodies."""

SMALLEST_RADIUS_M: Final = 1e-4

LARGEST_FRICTION: Final = 10.0  # largest coefficient of friction; rubber on a rough surface reaches 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """Common properties of planes and spheres. Each but the stiffness has no effect, and no cost, at zero."""

    name: str
    stiffness_n_per_m: float  # force per distance [N/m] between the tool and the surface point that it holds
    # Force per speed [N·s/m] along the normal during contact. It never makes the surface hold the tool back.
    viscosity_n_s_per_m: float = 0.0
    friction: float = 0.0  # Coulomb's coefficient of sliding friction (dimensionless)
    # Coefficient that the ratio of tangential to normal force must exceed before the tool slides; 0: as `friction`. A
    # larger one lets a slow tool stick and slip.
    static_friction: float = 0.0
    sliding_viscosity_n_s_per_m: float = 0.0  # force per speed [N·s/m] along the surface during contact
    # What vibrates (`scene.vibration`) at the first touch: frequency, decay, amplitude per speed. Under a tool that
    # slides: wavelength [m] of a texture, amplitude per speed
    ring_hz: float = 0.0
    ring_decay_per_s: float = 80.0
    touch_per_s: float = 0.0
    texture_m: float = 0.0
    texture_per_s: float = 0.0

    def __post_init__(self) -> None:
        where = f"body {self.name!r}:"
        check_parameter(f"{where} stiffness_n_per_m", self.stiffness_n_per_m, SMALLEST_VALUE, LARGEST_VALUE)
        for key in ("viscosity_n_s_per_m", "sliding_viscosity_n_s_per_m"):
            check_parameter(f"{where} {key}", getattr(self, key), SMALLEST_VALUE, LARGEST_VALUE, zero_allowed=True)
        check_parameter(f"{where} friction", self.friction, SMALLEST_VALUE, LARGEST_FRICTION, zero_allowed=True)
        check_ring(where, self)
        check_parameter(f"{where} texture_m", self.texture_m, 1e-5, 0.1, "m", zero_allowed=True)
        check_parameter(f"{where} texture_per_s", self.texture_per_s, 0.0, LARGEST_VALUE, "1/s")
        check_parameter(
            f"{where} static_friction", self.static_friction, self.friction, LARGEST_FRICTION, zero_allowed=True
        )

    @property
    def depends_on_time(self) -> bool:
        """Whether the force depends on the time of the motion, not only on the position."""
        return self.viscosity_n_s_per_m > 0.0 or self.sliding_viscosity_n_s_per_m > 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane(Body):
    """Everything beyond a plane; on two axes, beyond a line."""

    point_m: Vector  # A point [m] of the plane, one coordinate for each axis
    inward: Vector  # direction into the body; scaled to length 1

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
    """A sphere that is touched from outside; on two axes, a disc."""

    centre_m: Vector  # its centre [m], one coordinate for each axis
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
    """A scene's name and its bodies."""

    name: str
    bodies: tuple[AnyBody, ...]
    follower: FollowerSettings | None = None

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

    @property
    def stiffest_n_per_m(self) -> float:
        """Largest stiffness of a body."""
        return max(body.stiffness_n_per_m for body in self.bodies)


def _place(name: str, values: object) -> Vector:
    """Return two or three checked coordinates."""
    if not isinstance(values, (list, tuple)) or not 2 <= len(values) <= MAX_AXES:
        raise SettingsError(f"{name} is {values!r}; it must be 2 or {MAX_AXES} numbers")
    for value in values:
        check_parameter(name, value, -LARGEST_PLACE_M, LARGEST_PLACE_M)
    return tuple(map(float, values))


AnySceneSettings: TypeAlias = SceneSettings | BodySceneSettings
