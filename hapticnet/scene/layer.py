"""One layer of tissue: the needle that meets it, its force laws, its state, and its stiffness bound.

The contact law is a chain of closures, one per property in use: each takes a position or depth and returns a force, or
`None` if the tissue breaks. Properties that are zero add nothing to the chain.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.scene.ahead import LayerAhead
from hapticnet.scene.settings import LARGEST_EXPONENT, LARGEST_SPEED_M_PER_S, Contact, Tissue
from hapticnet.stiffness_bound import StiffnessBound

LONGEST_STEP_US: Final = 10**15
"""Limit of the duration [µs] of one step, about 32 years, so that the clock always fits a float."""


class Needle:
    """Position, speed and time of the needle, read by layers whose properties depend on them.

    Time is the sum of the forward differences of the sample time stamps. A stamp that repeats or goes backwards adds
    no time, and the next difference is taken from it, so a clock that is set back does not stop the scene.
    """

    __slots__ = ("_stamp_us", "now_us", "tip_m", "velocity_m_per_s")

    def __init__(self) -> None:
        self.tip_m = -LARGEST_COMPONENT  # position of the tip [m] at the newest sample
        # Velocity [m/s] since the previous sample, positive into the tissue; zero if no time has passed
        self.velocity_m_per_s = 0.0
        self.now_us = 0  # time [µs] that has passed since the first sample
        self._stamp_us: int | None = None

    def follow(self, other: "Needle") -> None:
        """Copy the state of another needle."""
        self.tip_m, self.velocity_m_per_s = other.tip_m, other.velocity_m_per_s
        self.now_us, self._stamp_us = other.now_us, other._stamp_us

    def advance(self, t_us: int, tip_m: float) -> None:
        """Advance time to the sample at `t_us`, at which the tip is at `tip_m`."""
        elapsed_us = 0 if self._stamp_us is None else t_us - self._stamp_us
        self._stamp_us = t_us
        if elapsed_us <= 0:
            self.velocity_m_per_s = 0.0
            return
        if elapsed_us > LONGEST_STEP_US:
            elapsed_us = LONGEST_STEP_US
        self.now_us += elapsed_us
        velocity_m_per_s = 1e6 * (tip_m - self.tip_m) / elapsed_us
        if abs(velocity_m_per_s) > LARGEST_SPEED_M_PER_S:
            velocity_m_per_s = math.copysign(LARGEST_SPEED_M_PER_S, velocity_m_per_s)
        self.velocity_m_per_s = velocity_m_per_s


Law: TypeAlias = Callable[[float], float | None]
"""Force [N] from a depth or tip position [m]; `None` if it would exceed the breach force."""


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

    def follow(self, other: "RecoveringSurface") -> None:
        """Copy the state of another surface."""
        self._released_m, self._released_us = other._released_m, other._released_us


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

    def follow(self, other: "Shaft") -> None:
        """Copy the state of another shaft."""
        self.force_n, self._tip_m = other.force_n, other._tip_m


def contact_law(tissue: Tissue, surface: Surface, needle: Needle) -> Law:
    """Return the force of an unpierced tissue as a function of the tip position."""
    # The law of a fixed surface takes the tip position, the law of a moving surface takes the depth below it.
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


def _nothing(_tip_m: float) -> float:
    """Return the force [N] of a pierced tissue without shaft friction."""
    return 0.0


class Layer:
    """A tissue of the scene, intact or pierced.

    The needle's god-object (Zilles and Salisbury, "A constraint-based god-object method for haptic display", 1995)
    stays on `surface`, where the tissue would be without the needle; the force grows with the distance of the tip from
    it. The visible surface follows the tip while it is indented.
    """

    __slots__ = ("_breach_depth_m", "_press", "_shaft", "breached", "feel", "is_felt", "rest_m", "surface", "tissue")

    def __init__(self, tissue: Tissue, needle: Needle) -> None:
        self.tissue: Final = tissue
        self.rest_m: Final = tissue.rest_position_m  # position [m] of the surface at rest
        # Position of the surface when the needle does not hold it
        self.surface: Final[Surface] = (
            RecoveringSurface(tissue, needle) if tissue.recovery_time_s else RestingSurface(tissue)
        )
        self._shaft = Shaft(tissue) if tissue.shaft_friction_n else None
        self._breach_depth_m = tissue.breach_depth_m
        self._press: Law = contact_law(tissue, self.surface, needle)
        self.heal()

    def heal(self) -> None:
        """Make the layer intact after the needle has been withdrawn."""
        self.breached = False
        self.is_felt = True  # whether the layer can exert a force on a needle past its surface
        self.feel = self._press  # force as a function of tip position: the contact law or the friction on the shaft

    def breach(self, tip_m: float) -> float:
        """Pierce the layer with the tip at `tip_m` and return the remaining force [N].

        The surface breaks at the depth where the elastic force reaches the breach force, even if the sample is
        beyond it. It springs back, and grips the shaft, from there.
        """
        broken_at_m = min(self.surface.position_m() + self._breach_depth_m, tip_m)
        self.surface.release(broken_at_m)
        self.breached = True
        if self._shaft is None:
            self.is_felt = False
            self.feel = _nothing
            return 0.0
        self._shaft.grip(broken_at_m)
        self.feel = self._shaft.slide
        return self._shaft.slide(tip_m)

    def follow(self, other: "Layer") -> None:
        """Copy the state of another layer of the same tissue."""
        if isinstance(self.surface, RecoveringSurface) and isinstance(other.surface, RecoveringSurface):
            self.surface.follow(other.surface)
        self.breached, self.is_felt = other.breached, other.is_felt
        if other.breached:
            self.feel = _nothing
            if self._shaft is not None and other._shaft is not None:
                self._shaft.follow(other._shaft)
                self.feel = self._shaft.slide

    def contact(self, tip_m: float) -> Contact:
        """Return the contact of a needle whose tip is at `tip_m`."""
        if self.breached:
            return Contact.PENETRATED
        return Contact.CONTACT if tip_m > self.surface.position_m() else Contact.NONE

    def ahead(self) -> LayerAhead:
        """Return the announcement of the layer."""
        tissue = self.tissue
        surface_m = self.surface.position_m()
        return LayerAhead(
            tissue.rest_position_m,
            tissue.stiffness_n_per_m,
            tissue.breach_force_n,
            tissue.viscosity_n_s_per_m,
            tissue.stiffening_per_m,
            tissue.shaft_friction_n,
            tissue.shaft_presliding_m,
            tissue.recovery_time_s,
            pierced=self.breached,
            raised_m=surface_m - self.rest_m,
            shaft_n=self._shaft.force_n if self._shaft is not None and self.breached else 0.0,
        )

    def surface_m(self, tip_m: float) -> float:
        """Return the position [m] of the visible surface for a tip at `tip_m`."""
        return tip_m if self.contact(tip_m) is Contact.CONTACT else self.surface.position_m()


MARGIN_M: Final = 1e-9
"""Distance [m] of a box from a surface and from the depth at which one breaks: more than any rounding error."""


class Grip(NamedTuple):
    """What one layer adds: stiffness [N/m], damping [N·s/m], stiffening [1/m], and where that is so [m]."""

    stiffness: float
    damping: float
    stiffening: float
    low_m: float
    high_m: float


def bound_of(felt: Sequence[Layer], passed: Sequence[Layer], ahead_m: float, tip_m: float) -> StiffnessBound | None:
    """Return the bound of a needle; None if a layer has none.

    `felt` are the layers that can exert a force at the tip, `passed` those that heal when it is withdrawn, and
    `ahead_m` is the position of the next surface.
    """
    stiffness = damping = stiffening = 0.0
    low_m = max((layer.surface.position_m() for layer in passed), default=-LARGEST_COMPONENT)
    high_m = ahead_m - MARGIN_M
    for layer in felt:
        grip = grip_of(layer)
        if grip is None:
            return None
        stiffness += grip.stiffness
        damping += grip.damping
        stiffening = max(stiffening, grip.stiffening)  # of the sum of the forces, of which none is negative
        low_m, high_m = max(low_m, grip.low_m), min(high_m, grip.high_m)
    if not low_m <= tip_m <= high_m:
        return None
    return StiffnessBound(stiffness, damping, (low_m,), (high_m,), stiffening)


def grip_of(layer: Layer) -> Grip | None:
    """Return what a layer that can exert a force adds; None if it cannot tell.

    The friction on a shaft depends on every turn of the hand, which a line does not show. A surface that is still
    recovering meets the needle at a time, not at a position, which matters with viscosity.
    """
    tissue = layer.tissue
    if layer.breached:
        return Grip(0.0, 0.0, 0.0, -LARGEST_COMPONENT, LARGEST_COMPONENT) if not layer.is_felt else None
    if tissue.viscosity_n_s_per_m and layer.surface.position_m() > layer.rest_m + MARGIN_M:
        return None
    return Grip(
        tissue.stiffness_n_per_m,
        tissue.viscosity_n_s_per_m,
        tissue.stiffening_per_m,  # dF/dx = k + a·F
        layer.rest_m,
        layer.rest_m + tissue.breach_depth_m - MARGIN_M,
    )
