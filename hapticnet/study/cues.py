"""What a finger learns about each tissue from one contact: the cues on which simulated observers decide."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray

EARLY_M: Final = 3e-3
"""Indentation [m] over which the early force is averaged."""

LEAST_DEPTH_M: Final = 1e-3
"""A contact that reaches less than this indentation [m] is not a look at the tissue: tremor grazes a surface."""

STEP_FROM_N: Final = 0.3
"""Held force [N] above which steps are measured; below it the floor of the threshold makes them larger."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """One contact with one tissue.

    Attributes
    ----------
    tissue
        Number of the tissue from front to back, from 0.
    peak_n
        Largest felt force [N].
    slope_n_per_m
        Slope of the felt force against position while the tip goes in [N/m].
    early_n
        Mean felt force [N] over the first `EARLY_M`.
    work_j
        Felt force times the way in [J].
    updates
        Number of changes of the held force.
    step
        Median relative change of the held force at an update, as |ln(after / before)|; 0 without updates.
    duration_s
        Duration of the contact [s].
    """

    tissue: int
    peak_n: float
    slope_n_per_m: float
    early_n: float
    work_j: float
    updates: int
    step: float
    duration_s: float


def looks(
    t_us: FloatArray,
    position_m: FloatArray,
    held_n: FloatArray,
    felt_n: FloatArray,
    *,
    surfaces_m: Sequence[float],
    breach_depths_m: Sequence[float],
) -> list[Look]:
    """Return every contact of a trial, in order of time.

    A contact begins when the tip passes a surface inwards. It ends when the tip leaves through the same surface, or is
    as far behind the breach as there is space before the next surface, so that what the device feels late still counts.

    Parameters
    ----------
    t_us, position_m, held_n, felt_n
        Time [µs], position of the tip [m], held force and force felt at the finger [N] of each tick, shape (n,).
    surfaces_m, breach_depths_m
        Position of each tissue's surface at rest and its indentation at the breach [m], front to back.
    """
    found = []
    ends_m = [*surfaces_m[1:], np.inf]
    for tissue, (surface_m, depth_m, end_m) in enumerate(zip(surfaces_m, breach_depths_m, ends_m, strict=True)):
        inside = (position_m >= surface_m) & (position_m < end_m)
        edges = np.flatnonzero(np.diff(inside.astype(np.int8), prepend=0, append=0))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if first == 0 or position_m[first - 1] >= surface_m:
                continue  # on the way out
            span = slice(int(first), int(last))
            if position_m[span].max() - surface_m < LEAST_DEPTH_M:
                continue
            found.append(
                (
                    int(first),
                    _look(tissue, t_us[span], position_m[span] - surface_m, held_n[span], felt_n[span], depth_m),
                )
            )
    return [look for _, look in sorted(found, key=lambda each: each[0])]


def _look(
    tissue: int, t_us: FloatArray, depth_m: FloatArray, held_n: FloatArray, felt_n: FloatArray, breach_m: float
) -> Look:
    through = np.flatnonzero(depth_m > breach_m)
    end = int(through[0]) if len(through) else len(depth_m)
    going_in = slice(0, max(int(depth_m[:end].argmax()) + 1 if end else 0, 2))
    depth, felt = depth_m[going_in], felt_n[going_in]
    spread = depth - depth.mean()
    early = depth <= EARLY_M
    steps = np.abs(np.diff(np.log(held_n[:end][held_n[:end] > STEP_FROM_N])))
    steps = steps[steps > 0.0]
    return Look(
        tissue=tissue,
        peak_n=float(felt_n.max()),
        slope_n_per_m=float(spread @ felt / max(spread @ spread, 1e-18)),
        early_n=float(felt[early].mean()) if early.any() else 0.0,
        work_j=float(np.sum(0.5 * (felt[1:] + felt[:-1]) * np.diff(depth))),
        updates=int(np.count_nonzero(np.diff(held_n[:end]))),
        step=float(np.median(steps)) if len(steps) else 0.0,
        duration_s=float(t_us[end - 1] - t_us[0]) * 1e-6 if end else 0.0,
    )
