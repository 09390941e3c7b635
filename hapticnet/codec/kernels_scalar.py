"""Whole-array encoders of one axis compiled by numba (the ``fast`` extra), equal to the streaming pairs to the bit.

What the kernels return is said in `kernels.encoding`.
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from hapticnet.arrays import FloatArray
from hapticnet.codec.base import Encoding
from hapticnet.codec.kernels import IntArray, SizeArray, encoding, fraction_and_floor, limited, room, rounded, shortcut
from hapticnet.codec.payload import COUNT_BYTES, LARGEST_COUNT, SINGLE_BYTES
from hapticnet.codec.predictive import IMPACT_THRESHOLDS
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT

LARGEST_WINDOW_US = 2**25
"""Sums of squared times in a window of 64 samples stay whole numbers of 64 bits up to here."""


def level_crossing(law: WeberLaw, stimuli: FloatArray, levels: Sequence[float], edges: Sequence[float]) -> Encoding:
    """Encode stimuli of shape (n, 1) by the levels on either side of zero and the ends of their cells."""
    weber, floor = fraction_and_floor(law)
    sent, sizes, decoded = room(stimuli)
    count = _levels(stimuli[:, 0], weber, floor, np.array(levels), np.array(edges), sent, sizes, decoded[:, 0])
    return encoding(stimuli, count, sent, sizes, decoded)


def linear_predictive(
    law: WeberLaw, t_us: IntArray, stimuli: FloatArray, *, slope_samples: int, horizon_ms: float, step_n: float
) -> Encoding | None:
    """Encode stimuli of shape (n, 1); None where times go back, or are too far apart for 64 bits."""
    times = np.ascontiguousarray(t_us, dtype=np.int64)
    if not _near_enough(times, LARGEST_WINDOW_US // slope_samples):
        return None
    weber, floor = fraction_and_floor(law)
    sent, sizes, decoded = room(stimuli)
    count = _lines(times, stimuli[:, 0], weber, floor, slope_samples, horizon_ms, step_n, sent, sizes, decoded[:, 0])
    return encoding(stimuli, count, sent, sizes, decoded)


@njit(cache=True, nogil=True, error_model="numpy")
def _levels(
    stimuli: FloatArray,
    weber: float,
    floor: float,
    levels: FloatArray,
    edges: FloatArray,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    count = 0
    low, high, reference, threshold = math.inf, -math.inf, 0.0, -1.0
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not low <= x <= high and not abs(x - reference) <= threshold:
            sent[count] = i
            size = abs(x)
            if not size <= LARGEST_COMPONENT:
                return ~count
            first, last = 0, edges.shape[0]
            while first < last:
                middle = (first + last) // 2
                if edges[middle] < size:
                    first = middle + 1
                else:
                    last = middle
            payload = 0
            if first < levels.shape[0]:
                reference = -levels[first] if x < 0.0 and first else levels[first]
                threshold = max(weber * abs(reference), floor)
                if abs(x - reference) <= threshold:
                    payload = COUNT_BYTES
            if payload == 0:
                payload, reference, threshold = rounded(x, weber, floor, 0.0)
            low, high = shortcut(reference, threshold)
            sizes[count] = payload
            count += 1
        decoded[i] = reference
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _near_enough(times: IntArray, largest_gap: int) -> bool:
    """Tell whether no time goes back or is further than so much after the one before."""
    for i in range(1, times.shape[0]):
        # Written so that no difference overflows: what is not near is not subtracted.
        if times[i] < times[i - 1] or times[i] // 2 - times[i - 1] // 2 > largest_gap // 2:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _slope(times: IntArray, stimuli: FloatArray, first: int, newest: int) -> float:
    """Return the slope [N/s] of the least-squares line through some samples; 0 when all are of one time."""
    count = newest + 1 - first
    total = squares = 0
    for k in range(first, newest + 1):
        apart = times[k] - times[newest]
        total += apart
        squares += apart * apart
    spread = count * squares - total * total
    if spread == 0:
        return 0.0
    product = 0.0
    for k in range(first, newest + 1):
        product += float(count * (times[k] - times[newest]) - total) * (stimuli[k] - stimuli[newest])
    return limited(1e6 * product / float(spread))


@njit(cache=True, nogil=True, error_model="numpy")
def _lines(
    times: IntArray,
    stimuli: FloatArray,
    weber: float,
    floor: float,
    slope_samples: int,
    horizon_ms: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    horizon, slope_step = horizon_ms * 1e3, step * 1e3 / horizon_ms
    count = 0
    since = 0  # no older sample counts: there was an impact
    start, value, rate = 0, 0.0, 0.0
    in_range = True
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        elapsed = float(times[i] - start)
        point = value + rate * min(elapsed, horizon) if elapsed > 0.0 else value
        if in_range:
            error, size = abs(x - point), abs(point)
        else:
            point = limited(point)
            error, size = math.sqrt((x - point) * (x - point)), math.sqrt(point * point)
        # One comparison where the stream has two: the second would often be mispredicted.
        if count == 0 or not error <= max(floor, weber * size):
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            if count and abs(x - point) > IMPACT_THRESHOLDS * max(weber * abs(point), floor):
                since = i
            slope = _slope(times, stimuli, max(since, i + 1 - slope_samples), i)
            payload, value, _ = rounded(x, weber, floor, step)
            if payload == COUNT_BYTES:
                counted = max(-float(LARGEST_COUNT), min(np.rint(slope / slope_step), float(LARGEST_COUNT)))
                slope = counted * slope_step + 0.0
                payload += COUNT_BYTES
            else:
                slope = np.float64(np.float32(slope))
                payload += SINGLE_BYTES
            rate = slope * 1e-6
            in_range = abs(value) + abs(rate) * horizon < LARGEST_COMPONENT
            start, point = times[i], value
            sizes[count] = payload
            count += 1
        decoded[i] = point
    return count
