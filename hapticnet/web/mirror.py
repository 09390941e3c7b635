"""A copy of the slave's scene, moved by the positions that the master sends: surfaces to draw, and the true force.

The forces from the slave's scene arrive compressed. A built-in scene is known by its name alone,
so the page can show the force before compression, and the effect of the delay. The copy differs from the
original where positions are lost at the moment of a breach, until the needle is withdrawn.
"""

import math
from collections.abc import Iterable
from typing import Final

from hapticnet.errors import HapticnetError
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import SceneSettings
from hapticnet.scene.sources import find_scene, scene_file

AHEAD_M: Final = 0.02  # free space [m] in front of the first surface
BEHIND_M: Final = 0.03
"""Space [m] behind the last surface. It does not depend on how deep that is indented before it breaks, which a person
in a trial must not know, except where it breaks deeper than this."""


def built_in(name: str) -> object:
    """Return the settings of the built-in scene of that name from the network, so without reading a file; or None."""
    try:
        return find_scene(name) if scene_file(name) is None else None
    except HapticnetError:
        return None


def scene_called(name: str) -> SceneSettings | None:
    """Return the built-in scene of tissues of that name; or None."""
    found = built_in(name)
    return found if isinstance(found, SceneSettings) else None  # bodies have no surfaces to draw on one axis


class Mirror:
    """A scene and a needle; unless it `is_new` (tissues intact), the force is unknown until the needle is in front."""

    def __init__(self, settings: SceneSettings, *, is_new: bool) -> None:
        self.settings = settings
        self.scene = Scene(settings.tissues, name=settings.name)  # in the state that the needle left
        self._first_m = self.scene.tissues[0].rest_position_m
        self._is_certain = is_new

    @property
    def range_m(self) -> tuple[float, float]:
        """Range of positions [m] shown."""
        tissues = self.scene.tissues
        broken_m = max(tissue.rest_position_m + tissue.breach_depth_m for tissue in tissues)
        return min(0.0, self._first_m - AHEAD_M), max(tissues[-1].rest_position_m + BEHIND_M, 1.05 * broken_m)

    def forces_n(self, t_us: Iterable[int], positions_m: Iterable[float]) -> list[float]:
        """Move the needle and return the force [N] at each position; NaN where it is not known."""
        forces_n = []
        for at_us, position_m in zip(t_us, positions_m, strict=True):
            force_n = self.scene.step(PositionSample(at_us, (position_m,))).force_n[0]
            self._is_certain = self._is_certain or position_m < self._first_m
            forces_n.append(force_n if self._is_certain else math.nan)
        return forces_n
