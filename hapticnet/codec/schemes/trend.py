"""What the newest samples say of the ones to come, and how well that has predicted them so far."""

import math
from typing import Final, NamedTuple

from hapticnet.codec.steps import Past
from hapticnet.samples import Vector
from hapticnet.vectors import along, magnitude, plus, times

Triple = tuple[float, float, float]


class Causes(NamedTuple):
    """What may move a stimulus: travels by the short and the long slope, and the distance to the level [N]."""

    short: Vector
    long: Vector
    level: Vector


class Trust(NamedTuple):
    """How well slopes and level have predicted: least squares over the curves that ended, with forgetting.

    Each curve that ends tells by how much the stimulus moved meanwhile. That is regressed on what the short slope, the
    long slope and the level would each have made of it alone, in thresholds, with less weight the more they predicted.

    Attributes
    ----------
    normal
        The upper triangle of the normal equations, row by row.
    right
        Their right-hand side.
    trusted
        Their solution.
    """

    normal: tuple[float, float, float, float, float, float]
    right: Triple
    trusted: Triple


SHORT: Final = 0.3
"""Length of the short window as a share of the long one."""

LEAST_SAMPLES: Final = 2
"""Samples beside the newest that a slope needs: with fewer, an impact would pass for a slope."""

LEAST_PERIODS: Final = 3.0
"""Sampling periods that a window is long at least, so that `LEAST_SAMPLES` are in it however slow the sampling is."""

MOST_SAMPLES: Final = 64
"""Samples that a slope is taken from, at most: it bounds the cost of an update."""

MEMORY: Final = 0.99
"""Weight of what was learned before when one more curve has ended: some hundred curves are remembered."""

CAUTION: Final = 0.5
"""Weight of what is believed before anything is learned, in curves that end a threshold away from their start."""

BELIEVED: Final = (0.5, 0.5, 0.0)
"""What is believed before anything is learned: the slope goes on, and the newest sample is the level."""

LEAD: Final = 0.55
"""Square root of how far a curve may get ahead of a slope that goes on, where both slopes agree, in thresholds.

A curve dies away, so it stays near a steady slope for longest if it starts steeper, and is ahead at first: with trust
1 + d, at a travel of T thresholds, by ``T·((1 + d)·s·(2 - s) - 2·s)``, at most ``T·d²/(1 + d)``. So d is up to LEAD/√T.
"""

SCATTER: Final = 0.05
"""Movements scatter with the variance of a squared threshold, and this share of what both slopes add up to, squared."""

LARGEST_LESSON: Final = 1e6
"""Larger movements, foretold or made, in squared thresholds, teach nothing: it keeps the equations well conditioned."""

SMALLEST_THRESHOLD_N: Final = 1e-100


UNTAUGHT: Final = Trust((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), BELIEVED)


def trend(past: Past, x: Vector, half_us: float, window_us: float, band_n: float) -> Causes:
    """Return what the newest samples say, axis by axis; zeros where they say nothing.

    The slopes are those of lines through the newest sample, fitted to the older ones with weights that fall linearly to
    zero at the end of each window, which is no shorter than `LEAST_PERIODS`. The level is how far from the newest
    sample a line passes that need not go through it. Going back, a sample further than `band_n` from the line so far
    ends the window: there was an impact.

    Parameters
    ----------
    half_us
        The slopes are given as the travels that they make in this time [µs].
    window_us
        Length of the long window [µs].
    """
    if past.newest > past.first:
        period_us = past.times_us[past.newest] - past.times_us[past.newest - 1]
        window_us = max(window_us, LEAST_PERIODS * period_us)
    if len(x) == 1:
        a = fit(past, 0, x[0], window_us, band_n)
        return Causes((half_us * a[0],), (half_us * a[1],), (a[2],))
    if len(x) == 2:
        a = fit(past, 0, x[0], window_us, band_n)
        b = fit(past, 1, x[1], window_us, band_n)
        return Causes((half_us * a[0], half_us * b[0]), (half_us * a[1], half_us * b[1]), (a[2], b[2]))
    a = fit(past, 0, x[0], window_us, band_n)
    b = fit(past, 1, x[1], window_us, band_n)
    c = fit(past, 2, x[2], window_us, band_n)
    return Causes(
        (half_us * a[0], half_us * b[0], half_us * c[0]),
        (half_us * a[1], half_us * b[1], half_us * c[1]),
        (a[2], b[2], c[2]),
    )


def fit(past: Past, axis: int, x: float, window_us: float, band_n: float) -> Triple:
    """Return short slope, long slope [N/µs] and level [N] of one axis."""
    times_us, samples = past.times_us, past.samples
    newest_us = times_us[past.newest]
    short_us = SHORT * window_us
    count = 0
    weights = 1.0  # the newest sample's own, in the fit of the level
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


def expected(trust: Trust, causes: Causes, threshold_n: float) -> Vector:
    """Return by how much the slopes are expected to move the stimulus."""
    a, b, _ = trust.trusted
    both = magnitude(plus(causes.short, causes.long))
    if a + b > 1.0 and both > 0.0:
        limit = min(1.0, (1.0 + LEAD * math.sqrt(2.0 * threshold_n / both)) / (a + b))
        a, b = limit * a, limit * b
    return along(times(causes.short, a), b, causes.long)


def taught(trust: Trust, causes: Causes, moved: Vector, share: float, threshold_n: float) -> Trust:
    """Return what is known after the stimulus moved while its curve made a share of its travel."""
    if not (threshold_n > SMALLEST_THRESHOLD_N and share > 0.0):
        return trust
    scale = 1.0 / threshold_n
    made = share * scale
    pp = pq = pr = qq = qr = rr = pm = qm = rm = mm = 0.0
    for axis in range(len(moved)):
        p, q, r = made * causes.short[axis], made * causes.long[axis], scale * causes.level[axis]
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
    if not pp + qq + rr + mm <= LARGEST_LESSON:
        return trust
    weight = 1.0 / (1.0 + SCATTER * (pp + 2.0 * pq + qq))
    aa, ab, ac, bb, bc, cc = trust.normal
    aa = MEMORY * aa + weight * pp
    ab = MEMORY * ab + weight * pq
    ac = MEMORY * ac + weight * pr
    bb = MEMORY * bb + weight * qq
    bc = MEMORY * bc + weight * qr
    cc = MEMORY * cc + weight * rr
    a, b, c = trust.right
    a, b, c = MEMORY * a + weight * pm, MEMORY * b + weight * qm, MEMORY * c + weight * rm
    normal, right = (aa, ab, ac, bb, bc, cc), (a, b, c)
    a, b, c = a + CAUTION * BELIEVED[0], b + CAUTION * BELIEVED[1], c + CAUTION * BELIEVED[2]
    # Caution makes the equations positive definite, so that elimination needs no pivots.
    aa += CAUTION
    factor_b, factor_c = ab / aa, ac / aa
    bb += CAUTION - factor_b * ab
    bc -= factor_b * ac
    b -= factor_b * a
    factor = bc / bb
    c = (c - factor_c * a - factor * b) / (cc + CAUTION - factor_c * ac - factor * bc)
    b = (b - bc * c) / bb
    a = (a - ab * b - ac * c) / aa
    # A trend that was always wrong is no reason to go the other way.
    return Trust(normal, right, (a, b, c) if a + b > 0.0 else (0.0, 0.0, c))
