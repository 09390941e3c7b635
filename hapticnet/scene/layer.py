"""One tissue and what the needle has done to it."""

from typing import Final

from hapticnet.scene.laws import Law, RecoveringSurface, RestingSurface, Shaft, Surface, contact_law
from hapticnet.scene.needle import Needle
from hapticnet.scene.tissue import Contact, Tissue


def _nothing(_tip_m: float) -> float:
    """Return the force [N] of a pierced tissue that lets the needle slide freely."""
    return 0.0


class Layer:
    """A tissue of the scene, whole or pierced.

    The needle's god-object (Zilles and Salisbury, "A constraint-based god-object method for haptic display",
    1995) stays on `surface`, where the tissue would be without the needle; the force grows with the tip's
    distance from it. The tissue that is seen follows the tip while it is indented.

    Attributes
    ----------
    rest_m
        Position [m] of the surface at rest.
    surface
        Where the surface is when the needle does not hold it.
    breached
        Whether the needle is through.
    feel
        Force over tip position, as the layer is now: its contact law, or the friction on the shaft.
    is_felt
        Whether the layer can exert a force on a needle beyond its surface.
    """

    __slots__ = ("_breach_depth_m", "_press", "_shaft", "breached", "feel", "is_felt", "rest_m", "surface")

    def __init__(self, tissue: Tissue, needle: Needle) -> None:
        self.rest_m: Final = tissue.rest_position_m
        self.surface: Final[Surface] = (
            RecoveringSurface(tissue, needle) if tissue.recovery_time_s else RestingSurface(tissue)
        )
        self._shaft = Shaft(tissue) if tissue.shaft_friction_n else None
        self._breach_depth_m = tissue.breach_depth_m
        self._press: Law = contact_law(tissue, self.surface, needle)
        self.heal()

    def heal(self) -> None:
        """Close behind a needle that has left."""
        self.breached = False
        self.is_felt = True
        self.feel = self._press

    def breach(self, tip_m: float) -> float:
        """Let the needle through to `tip_m` and return the force [N] that is left.

        The surface breaks at the depth where the elastic force reaches the breach force, however far beyond
        it the sample is; it springs back from there, and the shaft is gripped from there.
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

    def contact(self, tip_m: float) -> Contact:
        """Return what a needle with its tip at `tip_m` does to the layer."""
        if self.breached:
            return Contact.PENETRATED
        return Contact.CONTACT if tip_m > self.surface.position_m() else Contact.NONE

    def surface_m(self, tip_m: float) -> float:
        """Return where the surface is [m], given that the needle's tip is at `tip_m`."""
        return tip_m if self.contact(tip_m) is Contact.CONTACT else self.surface.position_m()
