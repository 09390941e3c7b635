"""What a robot can tell of the contact ahead from its own measurements: where, how stiff, at which force it broke.

`MeasuredScene` stands between the slave and anything that has forces of one axis. It knows nothing of it but positions
and forces, and announces

- the contact that it is in: a line through the newest forces, as far as they show a stiffness;
- the surfaces that it has touched before, with the force at which they broke, if they did.

A first contact is therefore met unannounced, and predicted from about a millimetre on; later ones are predicted whole.
"""

import math
from dataclasses import dataclass
from typing import Final

from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.ahead import STIFFEST_N_PER_M, LayerAhead
from hapticnet.scene.base import Touchable, breaches_of

CONTACT_N: Final = 0.02
"""Force above which there is contact [N]: above the noise of a force sensor, below the smallest JND of the paper."""

FORGET_M: Final = 1e-3  # travel [m] after which a force counts 1/e for the stiffness. A hand at rest forgets nothing.
LARGEST_DEVIATION: Final = 0.1  # largest standard deviation of a stiffness that is announced, as a share of it
NOISE_N: Final = 0.002  # smallest deviation of a force from the line that is reckoned with [N]

TOLERANCE_N: Final = 0.01
"""Error [N] of what was announced at which it is replaced by what is known now: below half a JND of the paper."""

SAME_SURFACE_M: Final = 2e-3  # surfaces that are no further apart [m] are one

MOST_SURFACES: Final = 64


class LineFit:
    """A line through forces over positions; each counts less, the further the tool has moved since."""

    __slots__ = ("_cff", "_cxf", "_cxx", "_f", "_newest_m", "_w", "_x", "deviation_n_per_m", "stiffness_n_per_m")

    def __init__(self, x_m: float, force_n: float) -> None:
        self._w, self._x, self._f = 1.0, x_m, force_n
        self._newest_m = x_m
        self._cxx = self._cxf = self._cff = 0.0
        # Slope [N/m] and its standard deviation; infinite where the tool has not moved
        self.stiffness_n_per_m, self.deviation_n_per_m = 0.0, math.inf

    def add(self, x_m: float, force_n: float) -> None:
        """Add a force [N] at a position [m]."""
        kept = math.exp(-abs(x_m - self._newest_m) / FORGET_M)
        self._newest_m = x_m
        self._w = kept * self._w + 1.0
        dx, df = x_m - self._x, force_n - self._f
        self._x += dx / self._w
        self._f += df / self._w
        self._cxx = kept * self._cxx + dx * (x_m - self._x)
        self._cxf = kept * self._cxf + dx * (force_n - self._f)
        self._cff = kept * self._cff + df * (force_n - self._f)
        if self._cxx > 0.0:
            self.stiffness_n_per_m = self._cxf / self._cxx
            left = max(self._cff - self.stiffness_n_per_m * self._cxf, 0.0) / self._w
            self.deviation_n_per_m = math.sqrt((left + NOISE_N**2) / self._cxx)

    @property
    def is_sure(self) -> bool:
        """Whether the stiffness is positive, allowed, and known well enough."""
        return (
            self.deviation_n_per_m <= LARGEST_DEVIATION * self.stiffness_n_per_m
            and self.stiffness_n_per_m <= STIFFEST_N_PER_M
        )

    def force_n(self, x_m: float) -> float:
        """Return the force of the line at a position [N]."""
        return self._f + self.stiffness_n_per_m * (x_m - self._x)

    @property
    def surface_m(self) -> float:
        """Where the line is 0 [m]."""
        return self._x - self._f / self.stiffness_n_per_m


@dataclass(slots=True)
class _Surface:
    """A surface that was touched."""

    at_m: float
    stiffness_n_per_m: float
    breach_force_n: float = math.inf
    pierced: bool = False

    def ahead(self) -> LayerAhead:
        return LayerAhead(self.at_m, self.stiffness_n_per_m, self.breach_force_n, pierced=self.pierced)


class MeasuredScene:
    """Something with forces of one axis, and what was learned of it. Satisfies `Touchable`.

    With two or three axes, nothing is announced.
    """

    def __init__(self, touched: Touchable) -> None:
        self.touched = touched
        self.axes, self.name = touched.axes, touched.name
        self._surfaces: list[_Surface] = []
        self._fit: LineFit | None = None
        self._now: _Surface | None = None  # what the tool presses on
        self._x_m = self._force_n = 0.0

    @property
    def breaches(self) -> int:
        """Surfaces breached so far, if what is touched counts them."""
        return breaches_of(self.touched)

    def welcome(self, master: str) -> None:
        """Tell what is touched the name of its master, if it wants to know."""
        welcome = getattr(self.touched, "welcome", None)
        if welcome is not None:
            welcome(master)

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force at a position, and learn from it."""
        result = self.touched.step(sample)
        if len(sample.position_m) == 1:
            self._learn(sample.position_m[0], result.force_n[0])
        return result

    def ahead(self) -> tuple[LayerAhead, ...] | None:
        """Return the present contact and the surfaces touched before, the nearest first; None where it cannot tell."""
        if self.axes > 1 or (self._fit is not None and self._now is None):
            return None
        known = sorted(self._surfaces, key=lambda surface: abs(surface.at_m - self._x_m))
        return tuple(surface.ahead() for surface in known)

    def _learn(self, x_m: float, force_n: float) -> None:
        for surface in self._surfaces:
            if surface.pierced and x_m < surface.at_m:
                surface.pierced = False
        broken = self._broken(x_m, force_n)
        if broken is not None:
            broken.pierced = True
            broken.breach_force_n = min(
                broken.breach_force_n, max(self._force_n, broken.stiffness_n_per_m * (x_m - broken.at_m))
            )
        if broken is not None or force_n <= CONTACT_N:
            self._fit = self._now = None
        elif self._fit is None:
            self._fit = LineFit(x_m, force_n)
            self._now = self._known(x_m)
        else:
            self._fit.add(x_m, force_n)
            if self._fit.is_sure:
                self._note(self._fit, x_m, force_n)
        self._x_m, self._force_n = x_m, force_n

    def _broken(self, x_m: float, force_n: float) -> _Surface | None:
        """Return the surface that has just broken: the force has gone, though the tool was not withdrawn."""
        now = self._now
        if now is None or self._force_n < 4.0 * CONTACT_N or force_n > 0.5 * self._force_n:
            return None
        return now if x_m - now.at_m > 0.5 * (self._x_m - now.at_m) else None

    def _known(self, x_m: float) -> _Surface | None:
        near = [surface for surface in self._surfaces if abs(surface.at_m - x_m) <= SAME_SURFACE_M]
        return min(near, key=lambda surface: abs(surface.at_m - x_m), default=None)

    def _note(self, fit: LineFit, x_m: float, force_n: float) -> None:
        """Take over what the newest forces say of the present contact."""
        if self._now is None:
            self._now = self._known(fit.surface_m)
        if self._now is None:
            self._now = _Surface(fit.surface_m, fit.stiffness_n_per_m)
            self._surfaces = [*self._surfaces[-MOST_SURFACES + 1 :], self._now]
        now = self._now
        # Compared with the line, not with the force: noise must not change what is announced.
        if abs(now.stiffness_n_per_m * (x_m - now.at_m) - fit.force_n(x_m)) > TOLERANCE_N:
            now.at_m, now.stiffness_n_per_m = fit.surface_m, fit.stiffness_n_per_m
        now.pierced = False
        if force_n > now.breach_force_n:  # it has grown stronger
            now.breach_force_n = math.inf
