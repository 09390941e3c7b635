"""Whole-array encoders of one axis for receivers that hold, compiled by numba (the ``fast`` extra).

Equal to the streaming pairs to the bit. What the kernels return is said in `kernels.encoding`.
"""

import math

import numpy as np
from numba import njit

from hapticnet.arrays import FloatArray
from hapticnet.codec.base import Encoding
from hapticnet.codec.kernels import IntArray, SizeArray, encoding, fraction_and_floor, room, rounded, shortcut
from hapticnet.codec.probabilistic import MOST_STATES
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT


def merging(law: WeberLaw, t_us: IntArray, stimuli: FloatArray, *, window_ms: float, step_n: float) -> Encoding:
    """Encode stimuli of shape (n, 1) with the deadband of `law`, one packet a window at most."""
    times = np.ascontiguousarray(t_us, dtype=np.int64)
    window_us = math.ceil(window_ms * 1e3)  # times are whole numbers
    weber, floor = fraction_and_floor(law)
    sent, sizes, decoded = room(stimuli)
    count = _merged(times, stimuli[:, 0], weber, floor, window_us, step_n, sent, sizes, decoded[:, 0])
    return encoding(stimuli, count, sent, sizes, decoded)


def probabilistic(law: WeberLaw, stimuli: FloatArray, *, loss: float, limit: float, step_n: float) -> Encoding:
    """Encode stimuli of shape (n, 1) for a receiver that loses so many, and may deviate with such a probability."""
    held, older = np.full(MOST_STATES, 1.0 - loss), np.full(MOST_STATES, loss)
    for age in range(1, MOST_STATES):
        held[age], older[age] = held[age - 1] * loss, older[age - 1] * loss
    held[0] = math.inf  # what leaves the dead zone of the newest is sent whatever the limit
    weber, floor = fraction_and_floor(law)
    sent, sizes, decoded = room(stimuli)
    count = _repeated(stimuli[:, 0], weber, floor, held, older, limit, step_n, sent, sizes, decoded[:, 0])
    return encoding(stimuli, count, sent, sizes, decoded)


@njit(cache=True, nogil=True, error_model="numpy")
def _merged(
    times: IntArray,
    stimuli: FloatArray,
    weber: float,
    floor: float,
    window: int,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    count = 0
    low, high, reference, threshold = math.inf, -math.inf, 0.0, -1.0
    start, open_window = 0, np.uint64(0)
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if times[i] >= start and np.uint64(times[i] - start) < open_window:
            if not abs(x) <= LARGEST_COMPONENT:
                sent[count] = i
                return ~count
        elif not low <= x <= high and not abs(x - reference) <= threshold:
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            sizes[count], reference, threshold = rounded(x, weber, floor, step)
            low, high = shortcut(reference, threshold)
            start, open_window = times[i], np.uint64(window)
            count += 1
        decoded[i] = reference
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _repeated(
    stimuli: FloatArray,
    weber: float,
    floor: float,
    held: FloatArray,
    older: FloatArray,
    limit: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    """`held` and `older`: by age of an update, with what probability it or an older one is held."""
    count = 0
    references, thresholds = np.empty(MOST_STATES), np.empty(MOST_STATES)
    reference = 0.0
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        doubt, silent = 0.0, False
        for age in range(min(count, MOST_STATES)):
            place = (count - 1 - age) % MOST_STATES
            if not abs(x - references[place]) <= thresholds[place]:
                doubt += held[age]
            if doubt + older[age] <= limit:
                silent = True
                break
            if doubt > limit:
                break
        if not silent:
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            sizes[count], reference, threshold = rounded(x, weber, floor, step)
            references[count % MOST_STATES], thresholds[count % MOST_STATES] = reference, threshold
            count += 1
        decoded[i] = reference
    return count
