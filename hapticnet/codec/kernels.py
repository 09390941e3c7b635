"""Whole-array encoders compiled by numba (the ``fast`` extra), equal to plain Python sample for sample.

Imported only where a recording is long enough to pay for loading it.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from hapticnet.codec.arrays import refuse_out_of_range
from hapticnet.codec.base import Encoding, FloatArray
from hapticnet.codec.payload import DOUBLE_BYTES, SINGLE_BYTES
from hapticnet.perception import WeberLaw

IntArray = npt.NDArray[np.int64]


def deadband(law: WeberLaw, stimuli: FloatArray) -> Encoding:
    """Encode stimuli of shape (n, a) with the deadband of `law`; a SampleError refuses what is out of range."""
    samples, axes = stimuli.shape
    sent = np.empty(samples, dtype=np.int64)
    wide = np.empty(samples, dtype=np.bool_)
    decoded = np.empty_like(stimuli)
    parameters = (law.weber_fraction, law.floor_n, law.multiplier)
    if axes == 1:
        count = _scalar(stimuli[:, 0], *parameters, sent, wide, decoded[:, 0])
    else:
        count = _vector(stimuli, *parameters, sent, wide, decoded)
    refuse_out_of_range(stimuli, sent[:count])
    sizes = np.where(wide[:count], DOUBLE_BYTES * axes, SINGLE_BYTES * axes).astype(np.int64)
    return Encoding(sent=sent[:count].copy(), decoded=decoded, payload_bytes=sizes)


@njit(cache=True, nogil=True)
def _scalar(
    stimuli: FloatArray,
    weber_fraction: float,
    floor_n: float,
    multiplier: float,
    sent: IntArray,
    wide: npt.NDArray[np.bool_],
    decoded: FloatArray,
) -> int:
    count = 0
    low, high, reference = math.inf, -math.inf, 0.0
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not low <= x <= high:
            reference = np.float64(np.float32(x))
            threshold = multiplier * max(weber_fraction * abs(reference), floor_n)
            wide[count] = not abs(x - reference) <= threshold
            if wide[count]:
                reference = x
                threshold = multiplier * max(weber_fraction * abs(reference), floor_n)
            high = reference + threshold
            if high - reference > threshold:
                high = np.nextafter(high, -math.inf)
            low = reference - threshold
            if reference - low > threshold:
                low = np.nextafter(low, math.inf)
            sent[count] = i
            count += 1
        decoded[i] = reference
    return count


@njit(cache=True, nogil=True)
def _vector(
    stimuli: FloatArray,
    weber_fraction: float,
    floor_n: float,
    multiplier: float,
    sent: IntArray,
    wide: npt.NDArray[np.bool_],
    decoded: FloatArray,
) -> int:
    axes = stimuli.shape[1]
    reference = np.zeros(axes)
    threshold = -1.0
    count = 0
    for i in range(stimuli.shape[0]):
        distance = 0.0
        for a in range(axes):
            distance += (stimuli[i, a] - reference[a]) ** 2
        if threshold < 0.0 or not math.sqrt(distance) <= threshold:
            square, rounding = 0.0, 0.0
            for a in range(axes):
                reference[a] = np.float64(np.float32(stimuli[i, a]))
                square += reference[a] * reference[a]
                rounding += (stimuli[i, a] - reference[a]) ** 2
            threshold = multiplier * max(weber_fraction * math.sqrt(square), floor_n)
            wide[count] = not math.sqrt(rounding) <= threshold
            if wide[count]:
                square = 0.0
                for a in range(axes):
                    reference[a] = stimuli[i, a]
                    square += reference[a] * reference[a]
                threshold = multiplier * max(weber_fraction * math.sqrt(square), floor_n)
            sent[count] = i
            count += 1
        for a in range(axes):
            decoded[i, a] = reference[a]
    return count
