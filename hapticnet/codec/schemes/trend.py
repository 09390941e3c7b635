"""The trend of the newest samples, and a regression that learns how much of it to use for a prediction."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from hapticnet.codec.steps import Past
from hapticnet.samples import Vector
from hapticnet.vectors import along, magnitude, plus, times

Triple = tuple[float, float, float]


class Trend(NamedTuple):
    """The trend of a stimulus: travels along its short and its long slope, and the distance to its level [N]."""

    short: Vector
    long: Vector
    level: Vector


class Regression(NamedTuple):
    """Recursive least squares with forgetting: how far the stimulus has followed each part of a trend.

    Each curve that ends is an observation: the movement of the stimulus since. It is regressed on how far the short
    slope, the long slope and the level would each have moved it, in thresholds. The larger these predictions, the less
    weight the observation has.
    """

    normal: tuple[float, float, float, float, float, float]  # Upper triangle of the normal equations, row by row
    right: Triple  # Their right-hand side
    coefficients: Triple  # Their solution: of the short slope, the long slope and the level


SHORT: Final = 0.3  # length of the short window as a share of the long one

LEAST_SAMPLES: Final = 2
"""Samples that a slope needs in addition to the newest. With fewer, an impact would look like a slope."""

LEAST_PERIODS: Final = 3.0  # shortest window in sampling periods, so that slow sampling also has `LEAST_SAMPLES` in it
MOST_SAMPLES: Final = 64  # most samples that a slope is fitted to; bounds the cost of an update

FORGETTING: Final = 0.99
"""Factor on the weight of all earlier observations at each new one: about a hundred curves are remembered."""

PRIOR_STRENGTH: Final = 0.5
"""Weight of `PRIOR` in the regression, in curves that end one threshold away from their start."""

PRIOR = (0.5, 0.5, 0.0)
"""Coefficients before anything is learned: the slope continues, and the newest sample is the level."""

LEAD: Final = 0.55
"""Square root of how far, in thresholds, a curve may lead a stimulus that continues along both slopes.

The slope of a curve falls to zero, so a curve stays near a steady slope for longest if it starts steeper and leads at
first. If the coefficients add up to 1 + d, and the travel is T thresholds, the lead is
``T·((1 + d)·s·(2 - s) - 2·s)``, at most ``T·d²/(1 + d)``. So d is limited to LEAD/√T.
"""

RELATIVE_VARIANCE: Final = 0.05
"""The variance of a movement is one squared threshold, plus this share of the squared sum of both slopes' travels."""

LARGEST_SQUARE: Final = 1e6
"""Observations with a larger sum of squares (in thresholds) are ignored, to keep the equations well conditioned."""

SMALLEST_THRESHOLD_N: Final = 1e-100


NOTHING_LEARNED: Final = Regression((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), PRIOR)


def measured_trend(past: Past, x: Vector, half_us: float, window_us: float, band_n: float) -> Trend:
    """Return the trend of the newest samples, axis by axis; zeros where there are too few.

    The slopes are those of lines through the newest sample, fitted to the older ones with weights that fall linearly to
    zero at the end of each window, which is at least `LEAST_PERIODS` long. The level is the distance from the newest
    sample to a line that is fitted without passing through it. Going back in time, a sample further than `band_n` from
    the line so far ends the window, because there was an impact.

    Parameters
    ----------
    half_us
        Time [µs] for which the slopes are extrapolated; they are returned as travels.
    window_us
        Length of the long window [µs].
    """
    window_us = lengthened(past.times_us, past.first, past.newest, window_us)
    if len(x) == 1:
        a = fit(past, 0, x[0], window_us, band_n)
        return Trend((half_us * a[0],), (half_us * a[1],), (a[2],))
    if len(x) == 2:
        a = fit(past, 0, x[0], window_us, band_n)
        b = fit(past, 1, x[1], window_us, band_n)
        return Trend((half_us * a[0], half_us * b[0]), (half_us * a[1], half_us * b[1]), (a[2], b[2]))
    a = fit(past, 0, x[0], window_us, band_n)
    b = fit(past, 1, x[1], window_us, band_n)
    c = fit(past, 2, x[2], window_us, band_n)
    return Trend(
        (half_us * a[0], half_us * b[0], half_us * c[0]),
        (half_us * a[1], half_us * b[1], half_us * c[1]),
        (a[2], b[2], c[2]),
    )


def lengthened(times_us: Sequence[float], first: int, newest: int, window_us: float) -> float:
    """Return the length of a window [µs], at least `LEAST_PERIODS`."""
    if newest == first:
        return window_us
    return max(window_us, LEAST_PERIODS * (times_us[newest] - times_us[newest - 1]))


def window_begin(times_us: Sequence[float], first: int, newest: int, window_us: float) -> int:
    """Return the index of the oldest sample, not before `first`, that `measured_trend` reads."""
    window_us = lengthened(times_us, first, newest, window_us)
    oldest = newest
    while oldest > first and times_us[newest] - times_us[oldest - 1] < window_us:
        oldest -= 1
    return oldest


def fit(past: Past, axis: int, x: float, window_us: float, band_n: float) -> Triple:
    """Return short slope, long slope [N/µs] and level [N] of one axis."""
    times_us, samples = past.times_us, past.samples
    newest_us = times_us[past.newest]
    short_us = SHORT * window_us
    count = 0
    weights = 1.0  # weight of the newest sample, which counts in the fit of the level
    moment = spread = product = rise = slope = short_spread = short_product = 0.0
    for k in range(past.newest - 1, max(past.newest - MOST_SAMPLES, past.first - 1), -1):
        age_us = newest_us - times_us[k]
        if age_us >= window_us:
            break
        if age_us <= 0:
            continue
        change = x - samples[k][axis]
        if count and not abs(change - slope * age_us) <= band_n:
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


def predicted_travel(regression: Regression, trend: Trend, threshold_n: float) -> Vector:
    """Return the predicted movement of the stimulus along the slopes [N]."""
    a, b, _ = regression.coefficients
    both = magnitude(plus(trend.short, trend.long))
    if a + b > 1.0 and both > 0.0:
        limit = min(1.0, (1.0 + LEAD * math.sqrt(2.0 * threshold_n / both)) / (a + b))
        a, b = limit * a, limit * b
    return along(times(trend.short, a), b, trend.long)


def updated(regression: Regression, trend: Trend, moved: Vector, share: float, threshold_n: float) -> Regression:
    """Return the regression after the stimulus moved by `moved` [N] while its curve covered a share of its travel."""
    if not (threshold_n > SMALLEST_THRESHOLD_N and share > 0.0):
        return regression
    scale = 1.0 / threshold_n
    made = share * scale
    pp = pq = pr = qq = qr = rr = pm = qm = rm = mm = 0.0
    for axis in range(len(moved)):
        p, q, r = made * trend.short[axis], made * trend.long[axis], scale * trend.level[axis]
        m = scale * moved[axis]
        pp += p * p
        pq += p * q
        pr += p * r
        qq += q * q
        qr += q * r
        rr += r * r
        pm += p * m
        qm += q * m
        rm += r * m
        mm += m * m
    if not pp + qq + rr + mm <= LARGEST_SQUARE:
        return regression
    weight = 1.0 / (1.0 + RELATIVE_VARIANCE * (pp + 2.0 * pq + qq))
    aa, ab, ac, bb, bc, cc = regression.normal
    aa = FORGETTING * aa + weight * pp
    ab = FORGETTING * ab + weight * pq
    ac = FORGETTING * ac + weight * pr
    bb = FORGETTING * bb + weight * qq
    bc = FORGETTING * bc + weight * qr
    cc = FORGETTING * cc + weight * rr
    a, b, c = regression.right
    a, b, c = FORGETTING * a + weight * pm, FORGETTING * b + weight * qm, FORGETTING * c + weight * rm
    normal, right = (aa, ab, ac, bb, bc, cc), (a, b, c)
    a, b, c = a + PRIOR_STRENGTH * PRIOR[0], b + PRIOR_STRENGTH * PRIOR[1], c + PRIOR_STRENGTH * PRIOR[2]
    # The prior makes the equations positive definite, so elimination needs no pivots.
    aa += PRIOR_STRENGTH
    factor_b, factor_c = ab / aa, ac / aa
    bb += PRIOR_STRENGTH - factor_b * ab
    bc -= factor_b * ac
    b -= factor_b * a
    factor = bc / bb
    c = (c - factor_c * a - factor * b) / (cc + PRIOR_STRENGTH - factor_c * ac - factor * bc)
    b = (b - bc * c) / bb
    a = (a - ab * b - ac * c) / aa
    # If the slopes were always wrong, use neither; do not extrapolate the opposite way.
    return Regression(normal, right, (a, b, c) if a + b > 0.0 else (0.0, 0.0, c))
