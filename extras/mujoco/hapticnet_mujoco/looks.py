"""How a MuJoCo model looks: each of its visible geoms as a shape, in metres of the hand."""

from collections.abc import Iterable
from typing import Any, Final

import mujoco
import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.scene.shapes import MOST_SHAPES, Shape

STEEP: Final = 0.5  # part of a unit vector above which it counts as level, or as independent of others
SHOWN_GROUPS: Final = 2  # as MuJoCo's own viewer shows at first
_KINDS: Final = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): ("plane", 0),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("sphere", 1),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", 2),
}
"""Name and number of sizes of what is drawn as it is. Anything else is drawn as its bounding box."""


class Looks:
    """The shapes of a model; `axes` are those of positions, in the world, and `origin_m` is position 0 [m]."""

    def __init__(self, model: Any, data: Any, origin_m: FloatArray, axes: FloatArray, scale: float = 1.0) -> None:
        self._origin = np.array(origin_m)
        self._scale = scale
        views = _views(axes)
        self._to_hand = _frame(axes, views)
        up, right, away = (tuple((self._to_hand @ each).tolist()) for each in views)
        visible = (model.geom_group <= SHOWN_GROUPS) & (model.geom_rgba[:, 3] > 0)
        is_fixed = model.body_weldid[model.geom_bodyid] == 0
        self._moving = _Geoms(model, np.flatnonzero(visible & ~is_fixed))
        fixed = self._turned(_Geoms(model, np.flatnonzero(visible & is_fixed)), data)
        self._fixed = [Shape("view", along=up, across=right, size_m=away), *fixed]

    def shapes(self, data: Any) -> list[Shape]:
        """Return the shapes in a state of the model."""
        return [*self._fixed, *self._turned(self._moving, data)][:MOST_SHAPES]

    def _turned(self, geoms: "_Geoms", data: Any) -> list[Shape]:
        turned = data.geom_xmat[geoms.numbers].reshape(-1, 3, 3)
        centres = data.geom_xpos[geoms.numbers] + np.einsum("nij,nj->ni", turned, geoms.offsets) - self._origin
        to_hand = self._to_hand.T
        vectors = (
            (centres @ to_hand / self._scale).tolist(),
            [(size / self._scale).tolist() for size in geoms.sizes],
            (turned[:, :, 2] * geoms.signs @ to_hand).tolist(),
            (turned[:, :, 0] @ to_hand).tolist(),
        )
        return [Shape(*each) for each in zip(geoms.kinds, *vectors, strict=True)]


class _Geoms:
    """Some geoms of a model: what does not change about them."""

    def __init__(self, model: Any, numbers: Any) -> None:
        self.numbers = numbers
        self.kinds: list[str] = []
        self.sizes: list[FloatArray] = []
        self.offsets = np.zeros((len(numbers), 3))
        self.signs = np.ones((len(numbers), 1))
        for place, geom in enumerate(numbers):
            kind, count = _KINDS.get(int(model.geom_type[geom]), ("box", 3))
            size = model.geom_size[geom][:count]
            if kind == "box":
                self.offsets[place] = model.geom_aabb[geom][:3]
                size = model.geom_aabb[geom][[5, 3, 4]]
            elif kind == "plane":  # solid behind its z axis
                self.signs[place] = -1.0
            self.kinds.append(kind)
            self.sizes.append(size)


def _views(axes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what is drawn up, right and away, in the world: the first axis down, or to the right if it is level."""
    up = np.array([0.0, 0.0, 1.0])
    level = axes[0] - axes[0] @ up * up
    right = level / np.linalg.norm(level) if np.linalg.norm(level) > STEEP else np.array([1.0, 0.0, 0.0])
    return up, right, np.cross(up, right)


def _frame(axes: FloatArray, views: Iterable[FloatArray]) -> FloatArray:
    """Return three unit vectors of the world, at right angles: the axes, and what is missing of the views."""
    rows = list(axes)
    for view in views:
        rest = view - sum((view @ row) * row for row in rows)
        if len(rows) < 3 and np.linalg.norm(rest) > STEEP:
            rows.append(rest / np.linalg.norm(rest))
    return np.array(rows)
