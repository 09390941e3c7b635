"""The contact that was announced, stepped by positions: the physics of the scene, on planes and from any state.

Slave and master run the same model. The master's is stepped by its own position, so that its force has no delay.
"""

import math
from collections.abc import Sequence

from hapticnet.samples import Vector
from hapticnet.scene.ahead import LARGEST_FORCE_N, LayerAhead
from hapticnet.scene.laws import LARGEST_EXPONENT
from hapticnet.scene.needle import LARGEST_SPEED_M_PER_S
from hapticnet.vectors import dot, minus, plus, times


class ContactModel:
    """Layers and a tool.

    Parameters
    ----------
    layers
        The layers in the state that they have at the first position.
    t_us, position_m
        The first position [m] and its time [µs].
    before
        The position before it with its time, if any: the speed of the tool is the difference.

    Attributes
    ----------
    force_n
        The force at the newest position [N].
    """

    __slots__ = ("_layers", "_position_m", "_t_us", "_velocity_m_per_s", "_zero_n", "force_n")

    def __init__(
        self, layers: Sequence[LayerAhead], t_us: int, position_m: Vector, before: tuple[int, Vector] | None
    ) -> None:
        self._layers = [_Layer(layer, position_m) for layer in layers]
        self._zero_n: Vector = (0.0,) * len(position_m)
        self._t_us, self._position_m = (t_us, position_m) if before is None else before
        self._move(t_us, position_m)
        self.force_n = self._press()

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
        """Return the force [N] at a position to come, without going there."""
        return ContactModel(self.layers(), self._t_us, self._position_m, None).step(t_us, position_m)

    def layers(self) -> tuple[LayerAhead, ...]:
        """Return the layers in the state that they have now."""
        return tuple(
            layer.given._replace(pierced=layer.pierced, raised_m=layer.raised_m, shaft_n=layer.shaft_n)
            for layer in self._layers
        )

    @property
    def state(self) -> int:
        """Which layers are pierced: the sum of 2ⁱ over them, in the order of the announcement."""
        return sum(layer.pierced << index for index, layer in enumerate(self._layers))

    def adopt(self, state: int) -> None:
        """Make those layers pierced or intact that `state` says are; the force follows."""
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
        """Return the force of all layers on the tool, where it is now."""
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
        """Pierce the layer at a depth, or heal it: a healed surface goes on returning."""
        self.pierced = pierced
        self.shaft_n = 0.0
        self._depth_m = depth_m
        if pierced and self.given.recovery_s:
            self.raised_m = depth_m

    def _slide(self, depth_m: float) -> float:
        """Return the friction on the shaft, after Dahl (`scene.laws.Shaft`)."""
        given = self.given
        travel_m = depth_m - self._depth_m
        if given.friction_n and travel_m:
            sliding_n = math.copysign(given.friction_n, travel_m)
            held = math.exp(-abs(travel_m) / given.presliding_m)
            self.shaft_n = sliding_n + (self.shaft_n - sliding_n) * held
        self._depth_m = depth_m
        return self.shaft_n
