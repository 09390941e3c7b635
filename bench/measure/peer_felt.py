"""The perceptible age of the force in the hand."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hapticnet.perception import WeberLaw
from hapticnet.samples import PositionSample
from hapticnet.scene.sources import find_source

ROUNDING_N: Final = 1e-6
"""Largest error of a force [N] of this scene as a float32."""

OLDEST_TICKS: Final = 1000
"""How far back positions are searched for one at which the force held was right."""


def ages(report: dict[str, Any], scene: str) -> dict[str, float | None]:
    """Return the age of the held force, from the ticks of a near end's window and the scene that it touched.

    ``age_…``: time [ms] since the position that the newest message answered. ``felt_p99_ms``: time since the newest
    position whose true force is within a JND of the force held; 0 where the held force is right, None where it was
    right at no position of the last second. ``wrong``: share of ticks at which it is not right now. ``rmse_n``: root
    mean square of its error [N] at the present positions.
    """
    ticks, start = report["ticks"], report["warm_up"]
    answered = [tick[3] for tick in ticks[start:] if tick[3] is not None]
    times_us, positions_m, held_n = (np.array([tick[column] for tick in ticks]) for column in range(3))
    true_n = true_forces_n(positions_m, scene)
    lags = felt_ticks(true_n, held_n)[start:]
    now = np.arange(start, len(ticks))
    felt_ms = np.where(lags < 0, np.inf, (times_us[now] - times_us[now - np.maximum(lags, 0)]) / 1e3)
    felt_p99_ms = float(np.percentile(felt_ms, 99, method="inverted_cdf"))
    return {
        "age_p50_ms": percentile(answered, 50, 1e-3),
        "age_p99_ms": percentile(answered, 99, 1e-3),
        "felt_p99_ms": felt_p99_ms if np.isfinite(felt_p99_ms) else None,
        "wrong": float(np.mean(lags != 0)),
        "rmse_n": float(np.sqrt(np.mean((held_n - true_n)[start:] ** 2))),
    }


def true_forces_n(positions_m: np.ndarray, name: str) -> np.ndarray:
    """Return the scene's forces at positions that all arrive in time, rounded as in messages."""
    scene = find_source(name).make()
    narrow = positions_m.astype(np.float32).tolist()
    return np.array([scene.step(PositionSample(t, (x,))).force_n[0] for t, x in enumerate(narrow)])


def felt_ticks(true_n: np.ndarray, held_n: np.ndarray) -> np.ndarray:
    """Return for each tick how many ticks ago the force held was within a JND of the true one; -1: never."""
    law = WeberLaw()
    jnd_n = np.array([law.threshold_n(force_n) for force_n in true_n.tolist()])
    lags = np.full(len(true_n), -1)
    unknown = np.arange(len(true_n))
    for lag in range(OLDEST_TICKS + 1):
        unknown = unknown[unknown >= lag]
        right = np.abs(held_n[unknown] - true_n[unknown - lag]) <= jnd_n[unknown - lag] + ROUNDING_N
        lags[unknown[right]] = lag
        unknown = unknown[~right]
    return lags


def percentile(values: Sequence[float], percent: float, factor: float) -> float | None:
    return factor * float(np.percentile(values, percent)) if values else None
