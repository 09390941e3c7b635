"""The hand of simulated observers: insertions that press each tissue long enough for the device to follow."""

from itertools import pairwise
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.operator.base import Operator
from hapticnet.operator.scripted import TREMOR_BAND_HZ, TREMOR_SINUSOIDS, TYPICAL_TREMOR_RMS_M
from hapticnet.operator.trace import TraceOperator
from hapticnet.study.trial import Stimulus

STEP_US: Final = 1000
INSERTIONS: Final = 2
MARGIN_M: Final = 2e-3  # a push begins so far before the surface and ends so far behind the breach

PUSH_S: Final = 1.1
"""Duration of a push [s], of which about 0.6 s are contact. At 0.24 s, the device reaches two thirds of 5 N only."""

BETWEEN_S: Final = 0.25
WITHDRAW_S: Final = 0.5
REST_S: Final = 0.3
VARIATION: Final = 0.1  # by which share these durations [s] vary; all are assumptions


def scripted_hand(stimulus: Stimulus) -> Operator:
    """Return the hand of a simulated observer, drawn from the seed of the trial.

    It pauses between tissues, never within one, so that a pause is no cue to the place.
    """
    rng = np.random.default_rng([stimulus.seed, 3])
    places_m, durations_s = [0.0], []
    for _ in range(INSERTIONS):
        for tissue in stimulus.tissues:
            places_m += [tissue.rest_position_m - MARGIN_M]
            places_m += [tissue.rest_position_m + tissue.breach_depth_m + MARGIN_M]
            durations_s += [BETWEEN_S, PUSH_S]
        places_m += [0.0, 0.0]
        durations_s += [WITHDRAW_S, REST_S]
    drawn_s = np.array(durations_s) * rng.uniform(1.0 - VARIATION, 1.0 + VARIATION, len(durations_s))
    phases = [
        _minimum_jerk(from_m, to_m, max(2, round(1e6 * duration_s) // STEP_US))
        for (from_m, to_m), duration_s in zip(pairwise(places_m), drawn_s.tolist(), strict=True)
    ]
    position_m = np.concatenate(phases)
    t_us = np.arange(len(position_m), dtype=np.int64) * STEP_US
    position_m += _tremor_m(t_us, rng)
    return TraceOperator(t_us, position_m[:, np.newaxis])


def _minimum_jerk(from_m: float, to_m: float, samples: int) -> FloatArray:
    """Return a movement after Flash and Hogan 1985 (`operator.scripted.ScriptedOperator`), shape (samples,)."""
    tau = np.arange(samples) / samples
    moved: FloatArray = from_m + (to_m - from_m) * tau**3 * (10.0 + tau * (6.0 * tau - 15.0))
    return moved


def _tremor_m(t_us: "np.ndarray[tuple[int, ...], np.dtype[np.int64]]", rng: np.random.Generator) -> FloatArray:
    low_hz, high_hz = TREMOR_BAND_HZ
    frequencies_hz = rng.uniform(low_hz, high_hz, TREMOR_SINUSOIDS)
    phases = rng.uniform(0.0, 2.0 * np.pi, TREMOR_SINUSOIDS)
    waves = np.sin(2e-6 * np.pi * frequencies_hz * t_us[:, np.newaxis] + phases)
    tremor: FloatArray = TYPICAL_TREMOR_RMS_M * np.sqrt(2.0 / TREMOR_SINUSOIDS) * waves.sum(axis=1)
    return tremor
