"""The deadband with many laws side by side, compiled by numba (the ``fast`` extra), so that they fill vector units.

Branches would be mispredicted: each law takes all steps of a send at every sample, and keeps what applies.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numba import njit

from hapticnet.arrays import FloatArray
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT

State: TypeAlias = tuple[float, float, float, float, float, float]


def sweep(laws: Sequence[WeberLaw], stimuli: FloatArray) -> FloatArray:
    """Return packets, rmse [N], largest error [N] and exceed-JND fraction, shape (4, m).

    Parameters
    ----------
    laws
        Such that their thresholds are nowhere less than `largest_rounding`.
    stimuli
        Stimuli in range, shape (n,).
    """
    weber = np.array([law.multiplier * law.weber_fraction for law in laws])
    floor = np.array([law.multiplier * law.floor_n for law in laws])
    jnd_weber = np.array([law.weber_fraction for law in laws])
    jnd_floor = np.array([law.floor_n for law in laws])
    # Reference, threshold (negative: nothing is within it), packets, squares, largest, exceeded.
    state = np.zeros((6, len(laws)))
    state[1] = -1.0
    _sweep(stimuli, weber, floor, jnd_weber, jnd_floor, *state)
    samples = max(len(stimuli), 1)
    return np.stack([state[2], np.sqrt(state[3] / samples), state[4], state[5] / samples])


@njit(cache=True, nogil=True, error_model="numpy")
def largest_rounding(stimuli: FloatArray) -> float:
    """Return by how much float32 moves a stimulus at most; infinity where one is not finite or out of range."""
    largest = 0.0
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not abs(x) <= LARGEST_COMPONENT:
            return np.inf
        largest = max(largest, abs(x - np.float64(np.float32(x))))
    return largest


@njit(cache=True, nogil=True, error_model="numpy")
def _sweep(
    stimuli: FloatArray,
    weber: FloatArray,
    floor: FloatArray,
    jnd_weber: FloatArray,
    jnd_floor: FloatArray,
    reference: FloatArray,
    threshold: FloatArray,
    packets: FloatArray,
    squares: FloatArray,
    largest: FloatArray,
    exceeded: FloatArray,
) -> None:
    samples, laws = stimuli.shape[0], weber.shape[0]
    # Two samples at a time: the state of a law is loaded and stored half as often. Four at a time are slower.
    for i in range(1, samples, 2):
        x, y = stimuli[i - 1], stimuli[i]
        x_single, y_single = np.float64(np.float32(x)), np.float64(np.float32(y))
        for k in range(laws):
            law = weber[k], floor[k], jnd_weber[k], jnd_floor[k]
            state = reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k]
            state = _step(y, y_single, law, _step(x, x_single, law, state))
            reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k] = state
    if samples % 2:
        x = stimuli[samples - 1]
        x_single = np.float64(np.float32(x))
        for k in range(laws):
            law = weber[k], floor[k], jnd_weber[k], jnd_floor[k]
            state = reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k]
            state = _step(x, x_single, law, state)
            reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k] = state


@njit(cache=True, nogil=True, error_model="numpy")
def _step(x: float, single: float, law: tuple[float, float, float, float], state: State) -> State:
    """Return the state of one law after a sample."""
    weber, floor, jnd_weber, jnd_floor = law
    reference, threshold, packets, squares, largest, exceeded = state
    holds = abs(x - reference) <= threshold
    around = weber * abs(single)
    around = around if around > floor else floor
    reference = reference if holds else single
    threshold = threshold if holds else around
    packets += 0.0 if holds else 1.0
    error = abs(x - reference)
    jnd = jnd_weber * abs(reference)
    jnd = jnd if jnd > jnd_floor else jnd_floor
    squares += error * error
    largest = error if error > largest else largest
    exceeded += 1.0 if error > jnd else 0.0
    return reference, threshold, packets, squares, largest, exceeded
