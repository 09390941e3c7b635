"""The adaptive-predictive encoder of one axis compiled by numba (the ``fast`` extra), equal to its stream to the bit.

For that every sum is taken in the order of `codec.adaptive_predictive` and `codec.trend`, where the reasons are told.
"""

import math
from typing import TypeAlias

import numpy as np
from numba import njit

from hapticnet.arrays import FloatArray
from hapticnet.codec.adaptive_predictive import BAND, LARGEST_OFFSET, LARGEST_TRAVEL, MOST_SAMPLES, TRAVEL
from hapticnet.codec.base import Encoding
from hapticnet.codec.kernels import IntArray, SizeArray, encoding, fraction_and_floor, room, rounded, since_us
from hapticnet.codec.predictive import IMPACT_THRESHOLDS
from hapticnet.codec.trend import (
    BELIEVED,
    CAUTION,
    LARGEST_LESSON,
    LEAD,
    LEAST_PERIODS,
    LEAST_SAMPLES,
    MEMORY,
    SCATTER,
    SHORT,
    SMALLEST_THRESHOLD_N,
)
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT

Triple: TypeAlias = tuple[float, float, float]
"""One for the short slope, one for the long slope, one for the level."""

Equations: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
"""What `codec.trend.Trust` has learned: the upper triangle of the normal equations row by row, then their right."""

TRAVEL_BYTES = TRAVEL[1].size


def adaptive_predictive(
    law: WeberLaw,
    t_us: IntArray,
    stimuli: FloatArray,
    *,
    horizon_ms: float,
    window_ms: float,
    jump_thresholds: float,
    step_n: float,
) -> Encoding:
    """Encode stimuli of shape (n, 1)."""
    times = np.ascontiguousarray(t_us, dtype=np.int64)
    sent, sizes, decoded = room(stimuli)
    given = *fraction_and_floor(law), horizon_ms * 1e3, window_ms * 1e3, jump_thresholds, step_n
    count = _curves(times, stimuli[:, 0], *given, sent, sizes, decoded[:, 0])
    return encoding(stimuli, count, sent, sizes, decoded)


@njit(cache=True, nogil=True, error_model="numpy")
def _share(elapsed_us: float, horizon_us: float) -> float:
    """Return how much of its travel a curve has made. What is limited here is what the stream tells apart."""
    s = max(0.0, min(elapsed_us / horizon_us, 1.0))
    return s * (2.0 - s)


@njit(cache=True, nogil=True, error_model="numpy")
def _within(x: float, limit: float) -> float:
    return max(-limit, min(x, limit))


@njit(cache=True, nogil=True, error_model="numpy")
def _moved(origin: float, by: float, limit: float) -> float:
    length = abs(by)
    return origin + (limit / length if length > limit else 1.0) * by


@njit(cache=True, nogil=True, error_model="numpy")
def _half_precision(x: float) -> float:
    """Return the float16 nearest to a number within its range, halves to even."""
    # Eleven bits, of which the last is worth no less than 2 ** -24.
    _, exponent = math.frexp(x)
    unit = math.ldexp(1.0, max(exponent, -13) - 11)
    units: float = np.rint(x / unit)
    return units * unit


@njit(cache=True, nogil=True, error_model="numpy")
def _taken(wanted: float, value: float, threshold: float) -> float:
    """Return the travel that the receiver takes from a payload."""
    if threshold == 0.0:
        return 0.0
    travel = _half_precision(_within(wanted / threshold, LARGEST_TRAVEL)) * threshold
    return travel if abs(value + travel) <= LARGEST_COMPONENT else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _trend(times: IntArray, stimuli: FloatArray, newest: int, band: float, window_us: float) -> Triple:
    """Return short slope, long slope and level, as `codec.trend.trend` does."""
    x = stimuli[newest]
    if newest:
        window_us = max(window_us, LEAST_PERIODS * since_us(times[newest - 1], times[newest]))
    short_us = SHORT * window_us
    count = 0
    weights = 1.0
    moment = spread = product = rise = slope = short_spread = short_product = 0.0
    for k in range(newest - 1, max(newest - MOST_SAMPLES, -1), -1):
        age_us = since_us(times[k], times[newest])
        if age_us >= window_us:
            break
        if age_us <= 0.0:
            continue
        change = x - stimuli[k]
        if count and not abs(change - slope * age_us) <= band:
            break
        count += 1
        weight = 1.0 - age_us / window_us
        weighted_us = weight * age_us
        weights += weight
        moment += weighted_us
        spread += weighted_us * age_us
        product += weighted_us * change
        rise += weight * change
        slope = product / spread
        if age_us < short_us:
            weighted_us = (1.0 - age_us / short_us) * age_us
            short_spread += weighted_us * age_us
            short_product += weighted_us * change
    if count < LEAST_SAMPLES:
        return 0.0, 0.0, 0.0
    free_slope = (weights * product - moment * rise) / (weights * spread - moment * moment)
    level = (free_slope * moment - rise) / weights
    return short_product / short_spread if short_spread > 0.0 else slope, slope, level


@njit(cache=True, nogil=True, error_model="numpy")
def _learned(
    learned: Equations, trusted: Triple, causes: Triple, moved: float, share: float, threshold: float
) -> tuple[Equations, Triple]:
    """Return what is known and what is trusted after one more curve has ended, as `codec.trend.Trust.learn` does."""
    if not (threshold > SMALLEST_THRESHOLD_N and share > 0.0):
        return learned, trusted
    scale = 1.0 / threshold
    made = share * scale
    p, q, r, m = made * causes[0], made * causes[1], scale * causes[2], scale * moved
    pp, qq = p * p, q * q
    if not pp + qq + r * r + m * m <= LARGEST_LESSON:
        return learned, trusted
    weight = 1.0 / (1.0 + SCATTER * (pp + 2.0 * (p * q) + qq))
    aa, ab, ac, bb, bc, cc, a, b, c = learned
    aa = MEMORY * aa + weight * pp
    ab = MEMORY * ab + weight * (p * q)
    ac = MEMORY * ac + weight * (p * r)
    bb = MEMORY * bb + weight * qq
    bc = MEMORY * bc + weight * (q * r)
    cc = MEMORY * cc + weight * (r * r)
    a, b, c = MEMORY * a + weight * (p * m), MEMORY * b + weight * (q * m), MEMORY * c + weight * (r * m)
    learned = aa, ab, ac, bb, bc, cc, a, b, c
    a, b, c = a + CAUTION * BELIEVED[0], b + CAUTION * BELIEVED[1], c + CAUTION * BELIEVED[2]
    aa += CAUTION
    factor_b, factor_c = ab / aa, ac / aa
    bb += CAUTION - factor_b * ab
    bc -= factor_b * ac
    b -= factor_b * a
    factor = bc / bb
    c = (c - factor_c * a - factor * b) / (cc + CAUTION - factor_c * ac - factor * bc)
    b = (b - bc * c) / bb
    a = (a - ab * b - ac * c) / aa
    return learned, ((a, b, c) if a + b > 0.0 else (0.0, 0.0, c))


@njit(cache=True, nogil=True, error_model="numpy")
def _foretold(trusted: Triple, causes: Triple, threshold: float) -> float:
    """Return by how much the stimulus is expected to move, as `codec.trend.Trust.foretell` does."""
    a, b, _ = trusted
    both = abs(causes[0] + causes[1])
    if a + b > 1.0 and both > 0.0:
        limit = min(1.0, (1.0 + LEAD * math.sqrt(2.0 * threshold / both)) / (a + b))
        a, b = limit * a, limit * b
    return a * causes[0] + b * causes[1]


@njit(cache=True, nogil=True, error_model="numpy")
def _curves(
    times: IntArray,
    stimuli: FloatArray,
    weber: float,
    floor: float,
    horizon_us: float,
    window_us: float,
    jump: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    half_us = 0.5 * horizon_us
    count = 0
    start_us, value, travel = 0, 0.0, 0.0
    sent_for, causes = 0.0, (0.0, 0.0, 0.0)
    learned, trusted = (0.0,) * 9, BELIEVED
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        share = _share(since_us(start_us, times[i]), horizon_us)
        point = value + travel * share
        error, threshold = abs(x - point), max(weber * abs(point), floor)
        if count == 0 or not error <= threshold:
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            if count and error <= IMPACT_THRESHOLDS * threshold:
                around = max(weber * abs(sent_for), floor)
                learned, trusted = _learned(learned, trusted, causes, x - sent_for, share, around)
            threshold = max(weber * abs(x), floor)
            short, long, level = _trend(times, stimuli, i, BAND * threshold, window_us)
            sent_for, causes = x, (half_us * short, half_us * long, level)
            expected = _foretold(trusted, causes, threshold)
            farthest = LARGEST_OFFSET * threshold / (1.0 + weber)
            start = wanted = _moved(x, trusted[2] * level, farthest)
            if count and jump > 0.0:
                start = _moved(point, wanted - point, jump * threshold)
                start = _moved(x, start - x, farthest)
                expected = expected + wanted - start
            size, value, threshold = rounded(_within(start, LARGEST_COMPONENT), weber, floor, step)
            if not abs(x - value) <= threshold:
                size, value, threshold = rounded(x, weber, floor, step)
            travel = _taken(expected, value, threshold)
            start_us = times[i]
            sizes[count] = size + TRAVEL_BYTES
            count += 1
            point = value + travel * 0.0  # which makes a plain zero of a negative one
        decoded[i] = point
    return count
