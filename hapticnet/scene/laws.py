"""Force laws of one tissue, built from its properties.

The contact law is a chain of closures, one per property in use: each takes a position or depth and returns a force, or
`None` if the tissue breaks. Properties that are zero add nothing to the chain.
"""

import math
from collections.abc import Callable
from typing import Final, TypeAlias

from hapticnet.scene.needle import Needle
from hapticnet.scene.tissue import Tissue

Law: TypeAlias = Callable[[float], float | None]
"""Force [N] from a depth or tip position [m]; `None` if it would exceed the breach force."""

LARGEST_EXPONENT: Final = 700.0
"""`math.expm1` overflows above 709; at this exponent the force exceeds any breach force."""


class RestingSurface:
    """A surface that returns to its rest position at once."""

    __slots__ = ("_rest_m",)

    def __init__(self, tissue: Tissue) -> None:
        self._rest_m = tissue.rest_position_m

    def position_m(self) -> float:
        """Return the position [m] of the surface when the needle does not hold it."""
        return self._rest_m

    def release(self, from_m: float) -> None:
        """Release the surface at the position where it was pierced."""


class RecoveringSurface:
    """A surface that relaxes exponentially to its rest position: s(t) = rest + (s₀ − rest)·exp(−t/τ).

    It is evaluated from the time of release, so the result does not depend on the steps in between.
    """

    __slots__ = ("_needle", "_released_m", "_released_us", "_rest_m", "_time_constant_us")

    def __init__(self, tissue: Tissue, needle: Needle) -> None:
        self._rest_m = tissue.rest_position_m
        self._time_constant_us = 1e6 * tissue.recovery_time_s
        self._needle = needle
        self._released_m = self._rest_m
        self._released_us = 0

    def position_m(self) -> float:
        """Return the position [m] of the surface when the needle does not hold it."""
        elapsed_us = self._needle.now_us - self._released_us
        decayed = math.exp(-elapsed_us / self._time_constant_us)
        position_m = self._rest_m + (self._released_m - self._rest_m) * decayed
        # Rounding must not carry it past a tip that is still where it pierced the surface.
        return position_m if position_m < self._released_m else self._released_m

    def release(self, from_m: float) -> None:
        """Release the surface at the position where it was pierced."""
        self._released_m = from_m
        self._released_us = self._needle.now_us


Surface: TypeAlias = RestingSurface | RecoveringSurface


class Shaft:
    """Friction of a pierced tissue on the needle's shaft, after Dahl.

    dF/dz = (F_c/δ)·(1 − (F/F_c)·sgn v): the tissue is dragged along over a length δ before it slides, at ±F_c. For
    motion in one direction this is F = s·F_c + (F₀ − s·F_c)·exp(−|Δz|/δ) with s = sgn Δz, which is evaluated exactly.
    The force is bounded, needs no velocity, and stays constant while the needle is at rest. It is negative during
    withdrawal, when the tissue holds the needle back.

    P. R. Dahl, "A solid friction model", The Aerospace Corporation, 1968. C. Kim and D. Y. Lee, "An empirical model of
    friction force between a needle and soft tissue", 2016, found this gradual rise in porcine tissue and used Dahl's
    model with a viscous term, which is omitted here.
    """

    __slots__ = ("_friction_n", "_presliding_m", "_tip_m", "force_n")

    def __init__(self, tissue: Tissue) -> None:
        self._friction_n = tissue.shaft_friction_n
        self._presliding_m = tissue.shaft_presliding_m
        self.force_n = 0.0
        self._tip_m = 0.0

    def grip(self, tip_m: float) -> None:
        """Grip, with zero force, a needle whose tip is at `tip_m`."""
        self.force_n = 0.0
        self._tip_m = tip_m

    def slide(self, tip_m: float) -> float:
        """Return the friction [N] on a needle whose tip moves to `tip_m`."""
        travel_m = tip_m - self._tip_m
        if travel_m != 0.0:
            self._tip_m = tip_m
            sliding_n = math.copysign(self._friction_n, travel_m)
            held = math.exp(-abs(travel_m) / self._presliding_m)
            self.force_n = sliding_n + (self.force_n - sliding_n) * held
        return self.force_n


def contact_law(tissue: Tissue, surface: Surface, needle: Needle) -> Law:
    """Return the force of an unpierced tissue as a function of the tip position."""
    # The law of a fixed surface takes the tip position, that of a moving surface the depth below it.
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

    Fung found that the tangent stiffness of soft tissue is linear in the load: Y. C. Fung, "Elasticity of soft tissues
    in simple elongation", American Journal of Physiology 213, 1967.
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
    """Kelvin–Voigt: a damper in parallel with the spring.

    The damper can reduce the force to zero but not below, and does not affect the breach: the velocity is a difference
    of two noisy positions, and the depth of the breach would depend on the sampling rate.
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
