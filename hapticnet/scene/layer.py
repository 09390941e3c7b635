"""One tissue of a scene and its state: intact or pierced."""

from typing import Final

from hapticnet.scene.ahead import LayerAhead
from hapticnet.scene.laws import Law, RecoveringSurface, RestingSurface, Shaft, Surface, contact_law
from hapticnet.scene.needle import Needle
from hapticnet.scene.tissue import Contact, Tissue


def _nothing(_tip_m: float) -> float:
    """Return the force [N] of a pierced tissue without shaft friction."""
    return 0.0


class Layer:
    """A tissue of the scene, intact or pierced.

    The needle's god-object (Zilles and Salisbury, "A constraint-based god-object method for haptic display", 1995)
    stays on `surface`, where the tissue would be without the needle; the force grows with the distance of the tip from
    it. The visible surface follows the tip while it is indented.

    Attributes
    ----------
    tissue
        Its properties.
    rest_m
        Position [m] of the surface at rest.
    surface
        Position of the surface when the needle does not hold it.
    breached
        Whether the needle has pierced the layer.
    feel
        Force as a function of tip position: the contact law or the friction on the shaft.
    is_felt
        Whether the layer can exert a force on a needle past its surface.
    """

    __slots__ = ("_breach_depth_m", "_press", "_shaft", "breached", "feel", "is_felt", "rest_m", "surface", "tissue")

    def __init__(self, tissue: Tissue, needle: Needle) -> None:
        self.tissue: Final = tissue
        self.rest_m: Final = tissue.rest_position_m
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
        self.is_felt = True
        self.feel = self._press

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

    def contact(self, tip_m: float) -> Contact:
        """Return the contact of a needle whose tip is at `tip_m`."""
        if self.breached:
            return Contact.PENETRATED
        return Contact.CONTACT if tip_m > self.surface.position_m() else Contact.NONE

    def ahead(self) -> LayerAhead:
        """Return the layer as it is announced."""
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
