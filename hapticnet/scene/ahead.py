"""The contact ahead: a scene's announcement, and the model that slave and master both run.

The model is the physics of the scene, on planes and from any state, stepped by positions. The master steps it by its
own position, so that its force has no delay.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

from hapticnet.errors import SampleError
from hapticnet.samples import Vector
from hapticnet.scene.settings import LARGEST_EXPONENT, LARGEST_SPEED_M_PER_S
from hapticnet.vectors import dot, minus, plus, times

MOST_LAYERS: Final = 8  # most layers of an announcement

REACH_M: Final = 0.05
"""Distance from the tool up to which layers are announced [m]: that of a hand in 250 ms at 200 mm/s."""

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

ROUNDING: Final = 1e-6  # share by which rounding to float32 may exceed a limit


class LayerAhead(NamedTuple):
    """A layer of tissue, a wall: its surface is a plane, at rest and untouched until the tool meets it.

    Defaults mean no such effect. The first nine values are properties, the others the state now.
    """

    surface_m: float  # position [m] of the surface at rest along the normal: a tool at x is x·n − surface past it
    stiffness_n_per_m: float  # elastic force per indentation [N/m], at the surface if the layer stiffens
    # Elastic force [N] above which the tool pierces the layer; infinity: it never does
    breach_force_n: float = math.inf
    viscosity_n_s_per_m: float = 0.0  # force per speed along the normal [N·s/m] while the surface is indented
    stiffening_per_m: float = 0.0  # relative growth of stiffness with indentation [1/m]
    # Friction [N] of the pierced layer on the tool, and the distance [m] over which it sets in
    friction_n: float = 0.0
    presliding_m: float = 0.5e-3
    recovery_s: float = 0.0  # time constant [s] with which a pierced surface returns to its rest position; 0: at once
    # Unit vector into the layer, one component an axis. The force is along it, positive where it pushes out.
    normal: Vector = (1.0,)
    pierced: bool = False  # whether the tool has pierced the layer, and has not been withdrawn since
    raised_m: float = 0.0  # distance of a returning surface behind its rest position after a breach [m]
    shaft_n: float = 0.0  # friction [N] now

    @property
    def stiffest_n_per_m(self) -> float:
        """Largest stiffness [N/m] at any indentation: with stiffening a, that is k + a·F at the largest force F."""
        return self.stiffness_n_per_m + self.stiffening_per_m * min(self.breach_force_n, LARGEST_FORCE_N)

    def depth_m(self, position_m: Vector) -> float:
        """Return how far a position is past the surface at rest [m]."""
        return dot(position_m, self.normal) - self.surface_m


LookAhead: TypeAlias = Callable[[], Sequence[LayerAhead] | None]
"""Returns the layers that can be met after the newest position, or None if unknown."""


def stiffest_at(rate_hz: float) -> float:
    """Return the largest sum of stiffnesses [N/m] that a master with this many ticks a second renders."""
    return min(STIFFEST_N_PER_M, STIFFEST_PER_HZ * rate_hz)


def check_layers(layers: Sequence[LayerAhead], axes: int, stiffest_n_per_m: float) -> None:
    """Raise SampleError if too many layers are announced, or a value is not finite or out of range."""
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
    """Return the message that layers together are stiffer than a master renders [N/m]."""
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


class ContactModel:
    """Layers, in the state that they have at the first position [m], and a tool.

    `before` is the position before the first one with its time [µs], if any: the speed of the tool is the difference.
    """

    __slots__ = ("_layers", "_position_m", "_t_us", "_velocity_m_per_s", "_zero_n", "force_n")

    def __init__(
        self, layers: Sequence[LayerAhead], t_us: int, position_m: Vector, before: tuple[int, Vector] | None
    ) -> None:
        self._layers = [_Layer(layer, position_m) for layer in layers]
        self._zero_n: Vector = (0.0,) * len(position_m)
        self._t_us, self._position_m = (t_us, position_m) if before is None else before
        self._move(t_us, position_m)
        self.force_n = self._press()  # the force at the newest position [N]

    def step(self, t_us: int, position_m: Vector) -> Vector:
        """Return the force [N] at the next position."""
        elapsed_us = t_us - self._t_us
        if elapsed_us > 0:
            for layer in self._layers:
                if layer.raised_m:
                    layer.raised_m *= math.exp(-1e-6 * elapsed_us / layer.given.recovery_s)
        self._move(t_us, position_m)
        self.force_n = self._press()
        return self.force_n

    def predict(self, t_us: int, position_m: Vector) -> Vector:
        """Return the force [N] at a future position, without moving there."""
        return ContactModel(self.layers(), self._t_us, self._position_m, None).step(t_us, position_m)

    def layers(self) -> tuple[LayerAhead, ...]:
        """Return the layers in their present state."""
        return tuple(
            layer.given._replace(pierced=layer.pierced, raised_m=layer.raised_m, shaft_n=layer.shaft_n)
            for layer in self._layers
        )

    @property
    def state(self) -> int:
        """Which layers are pierced: the sum of 2ⁱ over them, in the order of the announcement."""
        return sum(layer.pierced << index for index, layer in enumerate(self._layers))

    def adopt(self, state: int) -> None:
        """Set the layers pierced or intact according to `state`; update the force."""
        if state == self.state:
            return
        for index, layer in enumerate(self._layers):
            pierced = bool(state >> index & 1)
            if pierced != layer.pierced:
                layer.become(pierced, layer.given.depth_m(self._position_m))
        self.force_n = self._press()

    def _move(self, t_us: int, position_m: Vector) -> None:
        """Note position and velocity of the tool."""
        elapsed_us = t_us - self._t_us
        self._velocity_m_per_s = self._zero_n
        if elapsed_us > 0:
            self._velocity_m_per_s = times(minus(position_m, self._position_m), 1e6 / elapsed_us)
        self._t_us, self._position_m = t_us, position_m

    def _press(self) -> Vector:
        """Return the force of all layers on the tool at its present position."""
        total = self._zero_n
        for layer in self._layers:
            given = layer.given
            depth_m = given.depth_m(self._position_m)
            if depth_m <= 0.0 and not layer.pierced:
                continue
            force_n = layer.press(depth_m, dot(self._velocity_m_per_s, given.normal))
            if force_n:
                total = plus(total, times(given.normal, force_n))
        return total


class _Layer:
    """A layer and its state. Depths [m] are along the normal from the surface at rest."""

    __slots__ = ("_breach_depth_m", "_depth_m", "given", "pierced", "raised_m", "shaft_n")

    def __init__(self, given: LayerAhead, position_m: Vector) -> None:
        self.given = given
        self.pierced = given.pierced
        self.raised_m = given.raised_m if given.recovery_s else 0.0
        self.shaft_n = given.shaft_n
        self._depth_m = given.depth_m(position_m)
        stretch = given.breach_force_n / given.stiffness_n_per_m
        if given.stiffening_per_m:
            stretch = math.log1p(given.stiffening_per_m * stretch) / given.stiffening_per_m
        self._breach_depth_m = stretch

    def press(self, depth_m: float, speed_m_per_s: float) -> float:
        """Return the force [N] on a tool that is `depth_m` past the surface at rest."""
        if self.pierced:
            if depth_m >= self.raised_m:
                return self._slide(depth_m)
            self.become(False, depth_m)
        given = self.given
        indentation_m = depth_m - self.raised_m
        if indentation_m <= 0.0:
            return 0.0
        exponent = given.stiffening_per_m * indentation_m
        if exponent > LARGEST_EXPONENT:
            elastic_n = math.inf
        elif exponent:
            elastic_n = given.stiffness_n_per_m / given.stiffening_per_m * math.expm1(exponent)
        else:
            elastic_n = given.stiffness_n_per_m * indentation_m
        if elastic_n > given.breach_force_n:
            self.become(True, min(self.raised_m + self._breach_depth_m, depth_m))
            return self._slide(depth_m)
        if given.viscosity_n_s_per_m:
            speed = min(max(speed_m_per_s, -LARGEST_SPEED_M_PER_S), LARGEST_SPEED_M_PER_S)
            elastic_n = max(elastic_n + given.viscosity_n_s_per_m * speed, 0.0)
        return min(elastic_n, LARGEST_FORCE_N)

    def become(self, pierced: bool, depth_m: float) -> None:
        """Pierce the layer at a depth, or heal it: a healed surface keeps returning."""
        self.pierced = pierced
        self.shaft_n = 0.0
        self._depth_m = depth_m
        if pierced and self.given.recovery_s:
            self.raised_m = depth_m

    def _slide(self, depth_m: float) -> float:
        """Return the friction on the shaft, after Dahl (`scene.layer.Shaft`)."""
        given = self.given
        travel_m = depth_m - self._depth_m
        if given.friction_n and travel_m:
            sliding_n = math.copysign(given.friction_n, travel_m)
            held = math.exp(-abs(travel_m) / given.presliding_m)
            self.shaft_n = sliding_n + (self.shaft_n - sliding_n) * held
        self._depth_m = depth_m
        return self.shaft_n
