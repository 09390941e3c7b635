"""What a scene may say of the contact ahead: layers, each a plane with what it does to a tool past it."""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

from hapticnet.errors import SampleError
from hapticnet.samples import Vector
from hapticnet.vectors import dot

MOST_LAYERS: Final = 8
"""Most layers of an announcement."""

REACH_M: Final = 0.05
"""How far from the tool layers are announced [m]: as far as a hand comes in a round trip of 250 ms at 200 mm/s."""

STIFFEST_PER_HZ: Final = 10.0
"""Largest sum of the layers' stiffnesses, over the rate of the ticks [N·s/m].

A spring K that is rendered every T stays passive in a hand with damping b if b > K·T/2 (J. E. Colgate and G. Schenkel,
"Passivity of a class of sampled-data systems", Journal of Robotic Systems 14, 1997). This is 2·b for 5 N·s/m, an
assumption.
"""

STIFFEST_N_PER_M: Final = 1e4
LARGEST_FORCE_N: Final = 1000.0
"""Largest force of a layer; far above what any device renders, so that a force is finite at every position."""

LARGEST_VALUE: Final = 1e6
LARGEST_VISCOSITY: Final = 100.0
SMALLEST_VALUE: Final = 1e-9

ROUNDING: Final = 1e-6
"""Share by which rounding to float32 may exceed a limit."""


class LayerAhead(NamedTuple):
    """A layer of tissue, a wall: its surface is a plane, at rest and untouched until the tool meets it.

    The defaults say that there is no such effect. The first nine values are properties, the others the state now.

    Attributes
    ----------
    surface_m
        Position [m] of the surface at rest along the normal: a tool at x is x·n − surface past it.
    stiffness_n_per_m
        Elastic force per indentation [N/m], at the surface if the layer stiffens.
    breach_force_n
        Elastic force [N] above which the tool pierces the layer; infinity: it never does.
    viscosity_n_s_per_m
        Force per speed along the normal [N·s/m] while the surface is indented.
    stiffening_per_m
        Relative growth of stiffness with indentation [1/m].
    friction_n, presliding_m
        Friction [N] of the pierced layer on the tool, and the distance [m] over which it sets in.
    recovery_s
        Time constant [s] with which a pierced surface returns to its rest position; 0: at once.
    normal
        Unit vector into the layer, one component an axis. The force is along it, positive where it pushes out.
    pierced
        Whether the tool has pierced the layer, and has not been withdrawn since.
    raised_m
        How far the surface, which is returning after a breach, is behind its rest position [m].
    shaft_n
        Friction [N] now.
    """

    surface_m: float
    stiffness_n_per_m: float
    breach_force_n: float = math.inf
    viscosity_n_s_per_m: float = 0.0
    stiffening_per_m: float = 0.0
    friction_n: float = 0.0
    presliding_m: float = 0.5e-3
    recovery_s: float = 0.0
    normal: Vector = (1.0,)
    pierced: bool = False
    raised_m: float = 0.0
    shaft_n: float = 0.0

    @property
    def stiffest_n_per_m(self) -> float:
        """Largest stiffness [N/m] at any indentation: with stiffening a, that is k + a·F at the largest force F."""
        return self.stiffness_n_per_m + self.stiffening_per_m * min(self.breach_force_n, LARGEST_FORCE_N)

    def depth_m(self, position_m: Vector) -> float:
        """Return how far a position is past the surface at rest [m]."""
        return dot(position_m, self.normal) - self.surface_m


LookAhead: TypeAlias = Callable[[], Sequence[LayerAhead] | None]
"""Returns the layers that can be met from the newest position on, or None where the scene cannot tell now."""


def stiffest_at(rate_hz: float) -> float:
    """Return the largest sum of stiffnesses [N/m] that a master with so many ticks a second renders."""
    return min(STIFFEST_N_PER_M, STIFFEST_PER_HZ * rate_hz)


def check_layers(layers: Sequence[LayerAhead], axes: int, stiffest_n_per_m: float) -> None:
    """Check what is announced.

    Raises
    ------
    SampleError
        If there are too many layers, or a value is not finite or out of range.
    """
    if len(layers) > MOST_LAYERS:
        raise SampleError(f"{len(layers)} layers ahead; at most {MOST_LAYERS} are announced")
    for layer in layers:
        for name, (least, most) in _RANGES.items():
            value = getattr(layer, name)
            if not (least <= value <= most or (value == 0.0 and name in _MAY_BE_ZERO)):  # NaN is refused, too
                raise SampleError(f"{name} of a layer ahead is {value}; it must be between {least:g} and {most:g}")
        if len(layer.normal) != axes or not 0.99 <= math.hypot(*layer.normal) <= 1.01:
            raise SampleError(f"normal of a layer ahead is {layer.normal}; it must be a unit vector of {axes} axes")
        if not layer.breach_force_n == math.inf and not layer.breach_force_n <= LARGEST_VALUE:
            raise SampleError(f"breach force of a layer ahead is {layer.breach_force_n} N; at most {LARGEST_VALUE:g}")
    total = sum(layer.stiffest_n_per_m for layer in layers)
    if not total <= stiffest_n_per_m * (1.0 + ROUNDING):
        raise SampleError(too_stiff(layers, stiffest_n_per_m))


def too_stiff(layers: Sequence[LayerAhead], stiffest_n_per_m: float) -> str:
    """Return in words that layers are stiffer together than a master renders [N/m]."""
    total = sum(layer.stiffest_n_per_m for layer in layers)
    words = f"layers ahead of {total:g} N/m together; at most {stiffest_n_per_m:g} N/m are rendered at this rate"
    if any(layer.stiffening_per_m and layer.breach_force_n > LARGEST_FORCE_N for layer in layers):
        words += f". One that stiffens and does not break counts as stiff as it is at {LARGEST_FORCE_N:g} N"
    return words


_RANGES: Final = {
    "surface_m": (-LARGEST_VALUE, LARGEST_VALUE),
    "stiffness_n_per_m": (SMALLEST_VALUE, STIFFEST_N_PER_M),
    "breach_force_n": (SMALLEST_VALUE, math.inf),
    "viscosity_n_s_per_m": (SMALLEST_VALUE, LARGEST_VISCOSITY),
    "stiffening_per_m": (SMALLEST_VALUE, LARGEST_VALUE),
    "friction_n": (SMALLEST_VALUE, LARGEST_VALUE),
    "presliding_m": (SMALLEST_VALUE, LARGEST_VALUE),
    "recovery_s": (SMALLEST_VALUE, LARGEST_VALUE),
    "raised_m": (0.0, LARGEST_VALUE),
    "shaft_n": (-LARGEST_VALUE, LARGEST_VALUE),
}

_MAY_BE_ZERO: Final = {"viscosity_n_s_per_m", "stiffening_per_m", "friction_n", "recovery_s"}
