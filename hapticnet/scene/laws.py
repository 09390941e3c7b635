"""The mechanics of one tissue, put together from what it declares.

Contact is a chain of closures, one per declared property: each takes a number and returns a force, or
`None` when the tissue gives way. A property that is not declared has no link in the chain.
"""

import math
from collections.abc import Callable
from typing import Final, TypeAlias

from hapticnet.scene.needle import Needle
from hapticnet.scene.tissue import Tissue

Law: TypeAlias = Callable[[float], float | None]
"""Force [N] from an indentation or a tip position [m]; `None` when it would exceed the breach force."""

LARGEST_EXPONENT: Final = 700.0
"""`math.expm1` overflows above 709; the force is beyond any breach force well before."""


class RestingSurface:
    """A surface that goes back to its rest position at once."""

    __slots__ = ("_rest_m",)

    def __init__(self, tissue: Tissue) -> None:
        self._rest_m = tissue.rest_position_m

    def position_m(self) -> float:
        """Return where the surface is [m] when the needle does not hold it."""
        return self._rest_m

    def release(self, from_m: float) -> None:
        """Let the surface go from where it was pierced."""


class RecoveringSurface:
    """A surface that relaxes exponentially to its rest position: s(t) = rest + (s₀ − rest)·exp(−t/τ).

    It is evaluated from the time of its release, so that the result does not depend on the steps between.
    """

    __slots__ = ("_needle", "_released_m", "_released_us", "_rest_m", "_time_constant_us")

    def __init__(self, tissue: Tissue, needle: Needle) -> None:
        self._rest_m = tissue.rest_position_m
        self._time_constant_us = 1e6 * tissue.recovery_time_s
        self._needle = needle
        self._released_m = self._rest_m
        self._released_us = 0

    def position_m(self) -> float:
        """Return where the surface is [m] when the needle does not hold it."""
        elapsed_us = self._needle.now_us - self._released_us
        decayed = math.exp(-elapsed_us / self._time_constant_us)
        position_m = self._rest_m + (self._released_m - self._rest_m) * decayed
        # Rounding must not carry it past a tip that stands where it was pierced.
        return position_m if position_m < self._released_m else self._released_m

    def release(self, from_m: float) -> None:
        """Let the surface go from where it was pierced."""
        self._released_m = from_m
        self._released_us = self._needle.now_us


Surface: TypeAlias = RestingSurface | RecoveringSurface


class Shaft:
    """Friction of a pierced tissue on the needle's shaft, after Dahl.

    dF/dz = (F_c/δ)·(1 − (F/F_c)·sgn v): the tissue is dragged along over a length δ before it slides, at ±F_c.
    For motion in one direction this is F = s·F_c + (F₀ − s·F_c)·exp(−|Δz|/δ) with s = sgn Δz, which is
    evaluated exactly: it is bounded, needs no velocity, and holds its force while the needle is still.
    It is negative on the way out, when the tissue holds the needle.

    P. R. Dahl, "A solid friction model", The Aerospace Corporation, 1968. C. Kim and D. Y. Lee, "An empirical
    model of friction force between a needle and soft tissue", 2016, found this gradual rise in porcine
    tissue and used Dahl's model for it (with a viscous term, which is left out here).
    """

    __slots__ = ("_force_n", "_friction_n", "_presliding_m", "_tip_m")

    def __init__(self, tissue: Tissue) -> None:
        self._friction_n = tissue.shaft_friction_n
        self._presliding_m = tissue.shaft_presliding_m
        self._force_n = 0.0
        self._tip_m = 0.0

    def grip(self, tip_m: float) -> None:
        """Take hold, without force, of a needle whose tip is at `tip_m`."""
        self._force_n = 0.0
        self._tip_m = tip_m

    def slide(self, tip_m: float) -> float:
        """Return the friction [N] on a needle whose tip moves to `tip_m`."""
        travel_m = tip_m - self._tip_m
        if travel_m != 0.0:
            self._tip_m = tip_m
            sliding_n = math.copysign(self._friction_n, travel_m)
            held = math.exp(-abs(travel_m) / self._presliding_m)
            self._force_n = sliding_n + (self._force_n - sliding_n) * held
        return self._force_n


def contact_law(tissue: Tissue, surface: Surface, needle: Needle) -> Law:
    """Return the force of an unpierced tissue over the tip's position."""
    # Where the surface does not move the law starts at it; else it is given the distance from the surface.
    start_m = 0.0 if tissue.recovery_time_s else tissue.rest_position_m
    law = _stiffening(tissue, start_m) if tissue.stiffening_per_m else _linear(tissue, start_m)
    if tissue.viscosity_n_s_per_m:
        law = _damped(law, tissue, needle)
    if tissue.recovery_time_s:
        law = _from_surface(law, surface)
    return law


def _linear(tissue: Tissue, start_m: float) -> Law:
    stiffness_n_per_m = tissue.stiffness_n_per_m
    breach_force_n = tissue.breach_force_n

    def law(position_m: float) -> float | None:
        force_n = stiffness_n_per_m * (position_m - start_m)
        return force_n if force_n <= breach_force_n else None

    return law


def _stiffening(tissue: Tissue, start_m: float) -> Law:
    """F = (k/a)·(exp(a·x) − 1), so that dF/dx = k + a·F.

    Tangent stiffness that is linear in the load is Fung's finding for soft tissue: Y. C. Fung, "Elasticity of
    soft tissues in simple elongation", American Journal of Physiology 213, 1967.
    """
    stiffening_per_m = tissue.stiffening_per_m
    scale_n = tissue.stiffness_n_per_m / stiffening_per_m
    breach_force_n = tissue.breach_force_n

    def law(position_m: float) -> float | None:
        exponent = stiffening_per_m * (position_m - start_m)
        if exponent > LARGEST_EXPONENT:
            return None
        force_n = scale_n * math.expm1(exponent)
        return force_n if force_n <= breach_force_n else None

    return law


def _damped(elastic: Law, tissue: Tissue, needle: Needle) -> Law:
    """Kelvin–Voigt: a damper beside the spring.

    It can take force away but not pull, and has no part in the breach: a velocity from two positions carries
    their noise, and the depth of a breach would depend on the sampling rate.
    """
    viscosity_n_s_per_m = tissue.viscosity_n_s_per_m

    def law(position_m: float) -> float | None:
        elastic_n = elastic(position_m)
        if not elastic_n:
            return elastic_n
        force_n = elastic_n + viscosity_n_s_per_m * needle.velocity_m_per_s
        return force_n if force_n > 0.0 else 0.0

    return law


def _from_surface(law: Law, surface: Surface) -> Law:
    def press(tip_m: float) -> float | None:
        depth_m = tip_m - surface.position_m()
        return law(depth_m) if depth_m > 0.0 else 0.0

    return press
