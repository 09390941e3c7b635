"""Scenes of springs that break, over a row of numbers: compiled for the bank (docs/adr/0013).

A scene whose tissues have none of the optional properties remembers only which layers are pierced, so that a step is a
loop over its layers. `Scene` avoids that loop by a search; compiled, the loop costs less than the search.
"""

import heapq
from typing import Any, Final

import numpy as np

from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.scene.outlooks import MARGIN_M
from hapticnet.scene.scene import Scene
from hapticnet.scene.tissue import Tissue

MOST_TISSUES: Final = 16
"""Most tissues of a scene that fits into a row."""

SPRING_FIELDS: Final[list[Any]] = [
    ("tissues", np.int64),
    ("rest_m", np.float64, (MOST_TISSUES,)),
    ("stiffness_n_per_m", np.float64, (MOST_TISSUES,)),
    ("breach_n", np.float64, (MOST_TISSUES,)),
    ("breach_depth_m", np.float64, (MOST_TISSUES,)),
    ("pierced", np.uint8, (MOST_TISSUES,)),
    ("breaches", np.int64),
    ("tip_m", np.float64),
    ("force_n", np.float64),
]


def fits_row(scene: object) -> bool:
    """Tell whether a scene consists of springs that break, and of few enough."""
    return (
        type(scene) is Scene
        and len(scene.tissues) <= MOST_TISSUES
        and all(_is_spring(tissue) for tissue in scene.tissues)
    )


def feel(row: Any, tip_m: float) -> float:
    """Move the tip; return the force [N]. See `Scene.step`."""
    force_n = 0.0
    for layer in range(row.tissues):
        if tip_m < row.rest_m[layer]:
            row.pierced[layer] = 0
        elif not row.pierced[layer]:
            layer_n = row.stiffness_n_per_m[layer] * (tip_m - row.rest_m[layer])
            if layer_n <= row.breach_n[layer]:
                force_n += layer_n
            else:
                row.pierced[layer] = 1
                row.breaches += 1
    row.tip_m = tip_m
    row.force_n = force_n
    return force_n


def look(row: Any) -> tuple[float, float, float]:
    """Return the stiffness [N/m] around the tip, and the box in which it holds [m]; see `outlooks.outlook_of`."""
    stiffness, low_m, high_m = 0.0, -LARGEST_COMPONENT, LARGEST_COMPONENT
    for layer in range(row.tissues):
        if row.rest_m[layer] > row.tip_m:
            high_m = row.rest_m[layer]
            break
    high_m -= MARGIN_M
    for layer in range(row.tissues):
        if row.pierced[layer]:
            low_m = max(low_m, row.rest_m[layer])
        elif row.rest_m[layer] <= row.tip_m:
            stiffness += row.stiffness_n_per_m[layer]
            low_m = max(low_m, row.rest_m[layer])
            high_m = min(high_m, row.rest_m[layer] + row.breach_depth_m[layer] - MARGIN_M)
    return stiffness, low_m, high_m


def scene_to_row(scene: Scene, row: Any) -> None:
    """Copy a scene to a row."""
    row.tissues = len(scene.tissues)
    for number, layer in enumerate(scene._layers):
        tissue = layer.tissue
        row.rest_m[number], row.breach_depth_m[number] = tissue.rest_position_m, tissue.breach_depth_m
        row.stiffness_n_per_m[number], row.breach_n[number] = tissue.stiffness_n_per_m, tissue.breach_force_n
        row.pierced[number] = layer.breached
    row.breaches = scene.breaches
    row.tip_m, row.force_n = scene._needle.tip_m, scene.force_n


def scene_from_row(scene: Scene, row: Any) -> None:
    """Copy a row back to its scene."""
    scene.reset()
    scene.breaches = int(row.breaches)
    scene.force_n = float(row.force_n)
    scene._needle.tip_m = tip_m = float(row.tip_m)
    for layer, pierced in zip(scene._layers, row.pierced, strict=False):
        if pierced:
            layer.breach(tip_m)
            heapq.heappush(scene._passed, (-layer.surface.position_m(), layer.rest_m, layer))
    scene._reached = sum(layer.rest_m <= tip_m for layer in scene._layers)
    scene._felt = [layer for layer in scene._layers[: scene._reached] if layer.is_felt]
    scene._back_m = LARGEST_COMPONENT  # so that the next step finds the limits of the present group


def _is_spring(tissue: Tissue) -> bool:
    return not (tissue.depends_on_time or tissue.shaft_friction_n or tissue.stiffening_per_m)
