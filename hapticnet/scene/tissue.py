"""What a tissue is before a needle touches it: its place, its stiffness and what it takes to pierce it."""

import enum
import itertools
import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError

SMALLEST_VALUE: Final = 1e-9
"""Smallest value [SI units] of a property that is declared at all; below it, floating point runs out first."""

LARGEST_VALUE: Final = 1e6
"""Largest value [SI units] of any property. A stiffness of 1e6 N/m is bone and steel, not tissue."""

LONGEST_NAME: Final = 64
"""Bytes of UTF-8 that the protocol has room for where a master is told what it touches."""


class Contact(enum.IntEnum):
    """What the needle does to one tissue."""

    NONE = 0
    CONTACT = 1
    PENETRATED = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Tissue:
    """One layer of tissue, described by its surface.

    The first four properties make the tissue of "Cutaneous haptic deadband compression": a spring that gives
    way. Each of the others is left out of the computation while it is zero.

    Attributes
    ----------
    name
        What people call it.
    rest_position_m
        Where its surface is [m] when nothing touches it; it grows into the body.
    stiffness_n_per_m
        Force over indentation [N/m], at the surface where the tissue stiffens.
    breach_force_n
        Elastic force [N] above which the needle goes through.
    viscosity_n_s_per_m
        Force over speed [N·s/m] while the surface is indented.
    shaft_friction_n
        Friction [N] of the tissue on the shaft of a needle that slides through it.
    shaft_presliding_m
        How far [m] the tissue is dragged along before the shaft slides; only of use with `shaft_friction_n`.
        The default is an assumption.
    stiffening_per_m
        Relative growth of stiffness with indentation [1/m].
    recovery_time_s
        Time constant [s] with which a pierced surface returns to its rest position; at once when zero.

    Raises
    ------
    SettingsError
        When a value is not finite or not within what the scene can compute.
    """

    name: str
    rest_position_m: float
    stiffness_n_per_m: float
    breach_force_n: float
    viscosity_n_s_per_m: float = 0.0
    shaft_friction_n: float = 0.0
    shaft_presliding_m: float = 0.5e-3
    stiffening_per_m: float = 0.0
    recovery_time_s: float = 0.0

    def __post_init__(self) -> None:
        where = f"tissue {self.name!r}:"
        check_parameter(f"{where} rest_position_m", self.rest_position_m, -LARGEST_VALUE, LARGEST_VALUE)
        for key in ("stiffness_n_per_m", "breach_force_n", "shaft_presliding_m"):
            check_parameter(f"{where} {key}", getattr(self, key), SMALLEST_VALUE, LARGEST_VALUE)
        for key in ("viscosity_n_s_per_m", "shaft_friction_n", "stiffening_per_m", "recovery_time_s"):
            check_parameter(f"{where} {key}", getattr(self, key), SMALLEST_VALUE, LARGEST_VALUE, zero_allowed=True)

    @property
    def breach_depth_m(self) -> float:
        """Indentation [m] at which the elastic force reaches the breach force."""
        depth_m = self.breach_force_n / self.stiffness_n_per_m
        if self.stiffening_per_m:
            return math.log1p(self.stiffening_per_m * depth_m) / self.stiffening_per_m
        return depth_m

    @property
    def depends_on_time(self) -> bool:
        """Whether its force depends on when the needle moved, and not only on where to."""
        return self.viscosity_n_s_per_m > 0.0 or self.recovery_time_s > 0.0


def front_to_back(tissues: Sequence[Tissue]) -> tuple[Tissue, ...]:
    """Return the tissues in the order in which a needle meets them.

    Raises
    ------
    SettingsError
        When there is no tissue, or when two share a rest position.
    """
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


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSettings:
    """A scene on paper: a name, and the tissues from front to back, whichever order they came in.

    Raises
    ------
    SettingsError
        When there is no tissue, when two share a rest position or a name, or when a name cannot be told to a master.
    """

    name: str
    tissues: tuple[Tissue, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "tissues", front_to_back(self.tissues))
        names = [tissue.name for tissue in self.tissues]
        for name in (self.name, *names):
            if not name.isprintable() or not 0 < len(name.encode()) <= LONGEST_NAME:
                raise SettingsError(
                    f"name {reprlib.repr(name)} has {len(name.encode())} bytes; names are 1 to {LONGEST_NAME} bytes of"
                    " printable characters"
                )
            if names.count(name) > 1:
                raise SettingsError(f"{names.count(name)} tissues are called {name!r}; each needs a name of its own")
