"""Whole-array encoders compiled by numba (the ``fast`` extra), equal to plain Python sample for sample.

Imported only where a recording is long enough to pay for loading it.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from hapticnet.codec.arrays import MARGIN, refuse_out_of_range
from hapticnet.codec.base import Encoding, FloatArray
from hapticnet.codec.payload import DOUBLE_BYTES, SINGLE_BYTES
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT

IntArray = npt.NDArray[np.int64]


def deadband(law: WeberLaw, stimuli: FloatArray) -> Encoding:
    """Encode stimuli of shape (n, a) with the deadband of `law`; a SampleError refuses what is out of range."""
    samples, axes = stimuli.shape
    # Memory that is never written is never made resident, so room for the worst case costs nothing.
    sent = np.empty(samples, dtype=np.int64)
    wide = np.empty(samples, dtype=np.int64)
    decoded = np.empty_like(stimuli)
    parameters = law.multiplier * law.weber_fraction, law.multiplier * law.floor_n
    if axes == 1:
        count, wide_count = _scalar(stimuli[:, 0], *parameters, sent, wide, decoded[:, 0])
    else:
        count, wide_count = _vector(stimuli, *parameters, sent, wide, decoded)
    refuse_out_of_range(stimuli, sent[count : count + 1] if wide_count < 0 else sent[:0])
    sizes = np.full(count, SINGLE_BYTES * axes, dtype=np.uint16)
    sizes[wide[:wide_count]] = DOUBLE_BYTES * axes
    return Encoding(sent=sent[:count], decoded=decoded, payload_bytes=sizes)


@njit(cache=True, nogil=True, error_model="numpy")
def _scalar(
    stimuli: FloatArray,
    weber: float,
    floor: float,
    sent: IntArray,
    wide: IntArray,
    decoded: FloatArray,
) -> tuple[int, int]:
    """Return how many were sent, and how many of those as float64: their places among the sent are in `wide`.

    A stimulus that is out of range ends it: it is the next in `sent`, and the second number is negative.
    """
    count, wide_count = 0, 0
    low, high, reference, threshold = math.inf, -math.inf, 0.0, -1.0
    # The shortcut's half width, so that it needs no more steps than the rule itself: each send waits for it.
    inner_weber, inner_floor = weber * (1.0 - MARGIN), floor * (1.0 - MARGIN)
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not low <= x <= high and not abs(x - reference) <= threshold:
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return count, -1
            reference = np.float64(np.float32(x))
            threshold = max(weber * abs(reference), floor)
            if not abs(x - reference) <= threshold:
                wide[wide_count] = count
                wide_count += 1
                reference = x
                threshold = max(weber * abs(reference), floor)
            half = max(inner_weber * abs(reference), inner_floor) - MARGIN * abs(reference)
            low, high = reference - half, reference + half
            count += 1
        decoded[i] = reference
    return count, wide_count


@njit(cache=True, nogil=True, error_model="numpy")
def _vector(
    stimuli: FloatArray,
    weber: float,
    floor: float,
    sent: IntArray,
    wide: IntArray,
    decoded: FloatArray,
) -> tuple[int, int]:
    """Return how many were sent, and how many of those as float64: their places among the sent are in `wide`.

    A stimulus that is out of range ends it: it is the next in `sent`, and the second number is negative.
    """
    axes = stimuli.shape[1]
    reference = np.zeros(axes)
    threshold = -1.0
    count, wide_count = 0, 0
    for i in range(stimuli.shape[0]):
        distance = 0.0
        for a in range(axes):
            distance += (stimuli[i, a] - reference[a]) ** 2
        if threshold < 0.0 or not math.sqrt(distance) <= threshold:
            sent[count] = i
            square, rounding = 0.0, 0.0
            for a in range(axes):
                if not abs(stimuli[i, a]) <= LARGEST_COMPONENT:
                    return count, -1
                reference[a] = np.float64(np.float32(stimuli[i, a]))
                square += reference[a] * reference[a]
                rounding += (stimuli[i, a] - reference[a]) ** 2
            threshold = max(weber * math.sqrt(square), floor)
            if not math.sqrt(rounding) <= threshold:
                wide[wide_count] = count
                wide_count += 1
                square = 0.0
                for a in range(axes):
                    reference[a] = stimuli[i, a]
                    square += reference[a] * reference[a]
                threshold = max(weber * math.sqrt(square), floor)
            count += 1
        for a in range(axes):
            decoded[i, a] = reference[a]
    return count, wide_count
