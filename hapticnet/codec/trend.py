"""What the newest samples say of the ones to come, and how far that has been true so far."""

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

from hapticnet.samples import Vector, magnitude

Vectors: TypeAlias = tuple[Vector, Vector, Vector]

SHORT: Final = 0.3
"""Length of the short window as a share of the long one."""

LEAST_SAMPLES: Final = 2
"""Samples beside the newest that a slope needs: with fewer, an impact would pass for a slope."""

LEAST_PERIODS: Final = 3.0
"""Sampling periods that a window is long at least, so that `LEAST_SAMPLES` are in it however slow the sampling is."""

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


def trend(samples: Sequence[tuple[int, Vector]], *, band_n: float, window_us: float) -> Vectors:
    """Return short slope, long slope [N/µs] and level [N], an axis at a time; zeros where samples say nothing.

    The slopes are those of lines through the newest sample, fitted to the older ones with weights that fall linearly to
    zero at the end of each window, which is no shorter than `LEAST_PERIODS`. The level is how far from the newest
    sample a line passes that need not go through it. Going back, a sample further than `band_n` from the line so far
    ends the window: there was an impact.
    """
    if len(samples) > 1:
        window_us = max(window_us, LEAST_PERIODS * (samples[-1][0] - samples[-2][0]))
    fits = [_fit(samples, axis, band_n, window_us) for axis in range(len(samples[-1][1]))]
    short, long, level = zip(*fits, strict=True)
    return short, long, level


def _fit(
    samples: Sequence[tuple[int, Vector]], axis: int, band_n: float, window_us: float
) -> tuple[float, float, float]:
    older = reversed(samples)
    newest_us, newest = next(older)
    x = newest[axis]
    short_us = SHORT * window_us
    count = 0
    weights = 1.0  # the newest sample's own, in the fit of the level
    moment = spread = product = rise = slope = short_spread = short_product = 0.0
    for at_us, sample in older:
        age_us = newest_us - at_us
        if age_us >= window_us:
            break
        if age_us <= 0:
            continue
        change = x - sample[axis]
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
    return short_product / short_spread if short_spread else slope, slope, level


class Trust:
    """How far slopes and level have foretold the stimulus: least squares over the curves that ended, with forgetting.

    Each curve that ends says by how much the stimulus moved meanwhile. That is regressed on what the short slope, the
    long slope and the level would each have made of it alone, in thresholds, with less weight the more they foretold.
    """

    __slots__ = ("_normal", "_right", "_trusted")

    def __init__(self) -> None:
        self._normal = (0.0,) * 6  # the upper triangle, row by row
        self._right = (0.0,) * 3
        self._trusted = BELIEVED

    def foretell(self, causes: Vectors, threshold_n: float) -> tuple[Vector, Vector]:
        """Return by how much the slopes' travels are expected to move the stimulus, and how far off its level is."""
        a, b, c = self._trusted
        short, long, level = causes
        both = magnitude(tuple([x + y for x, y in zip(short, long, strict=True)]))
        if a + b > 1.0 and both:
            limit = min(1.0, (1.0 + LEAD * math.sqrt(2.0 * threshold_n / both)) / (a + b))
            a, b = limit * a, limit * b
        return tuple([a * x + b * y for x, y in zip(short, long, strict=True)]), tuple([c * x for x in level])

    def learn(self, causes: Vectors, moved: Vector, share: float, threshold_n: float) -> None:
        """Take in by how much the stimulus moved while its curve made a share of its travel."""
        if not (threshold_n > SMALLEST_THRESHOLD_N and share > 0.0):
            return
        scale = 1.0 / threshold_n
        made = share * scale
        pp = pq = pr = qq = qr = rr = pm = qm = rm = mm = 0.0
        for short, long, level, move in zip(*causes, moved, strict=True):
            p, q, r, m = made * short, made * long, scale * level, scale * move
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
            return
        weight = 1.0 / (1.0 + SCATTER * (pp + 2.0 * pq + qq))
        aa, ab, ac, bb, bc, cc = self._normal
        aa = MEMORY * aa + weight * pp
        ab = MEMORY * ab + weight * pq
        ac = MEMORY * ac + weight * pr
        bb = MEMORY * bb + weight * qq
        bc = MEMORY * bc + weight * qr
        cc = MEMORY * cc + weight * rr
        self._normal = aa, ab, ac, bb, bc, cc
        a, b, c = self._right
        self._right = a, b, c = MEMORY * a + weight * pm, MEMORY * b + weight * qm, MEMORY * c + weight * rm
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
        self._trusted = (a, b, c) if a + b > 0.0 else (0.0, 0.0, c)
