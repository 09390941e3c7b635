"""From the force sensor's counts to newton: a monotone piecewise-linear table, and how to get one from measurements."""

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.hardware import SENSOR_THRESHOLD_N

Numbers: TypeAlias = NDArray[np.float64]

LARGEST: Final = 1e6
"""Counts and newtons of a table go so far at most, which is beyond any sensor."""

MOST_KNOTS: Final = 8
"""Knots of a fitted table. It follows a sensor whose conductance is linear in force within 3 % from 0.2 to 10 N."""

FULL_SCALE_COUNTS: Final = 1023.0
"""Highest count of the ATmega328P's 10-bit converter. Means within one of it were saturated part of the time."""

LARGEST_FORCE_N: Final = 100.0
"""Force [N] above which a pair is taken for grams: five times the range of the FSR 400 series (20 N, data sheet)."""

FLATTEST_SLOPE: Final = 0.01
"""Least slope of a fitted table, as a fraction of its mean slope.

A force loop is blind where the table is flat. A sensor linear in conductance is nowhere flatter than 5 % of its mean
slope up to 20 N, so only noise is bent by this.
"""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Pairs of converter counts and the force that gave them, joined by straight lines.

    Below the first pair the force falls in a straight line to 0 N at 0 counts; above the last it stays at the last
    pair's force, because a sensor beyond its range says only "at least that".

    Attributes
    ----------
    counts
        Converter counts, positive and strictly increasing.
    forces_n
        The force [N] at each of them, positive and strictly increasing.

    Raises
    ------
    SettingsError
        If there are fewer than two pairs, or a column is not finite, positive and strictly increasing.

    Examples
    --------
    >>> Calibration(counts=(100.0, 200.0), forces_n=(0.5, 2.5)).force_n(150)
    1.5
    """

    counts: tuple[float, ...]
    forces_n: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.counts) != len(self.forces_n) or len(self.counts) < 2:
            raise SettingsError(
                f"calibration has {len(self.counts)} counts and {len(self.forces_n)} forces; "
                "it needs as many of one as of the other, and two at least"
            )
        for name, column in (("counts", self.counts), ("forces [N]", self.forces_n)):
            for before, after in zip((0.0, *column), column, strict=False):
                if not before < after <= LARGEST:
                    raise SettingsError(
                        f"calibration {name} go from {before:g} to {after:g}; "
                        f"they must be above 0, strictly increasing and {LARGEST:g} at most"
                    )

    def force_n(self, adc: float) -> float:
        """Return the force [N] that belongs to a reading in counts (averaged readings may have a fraction)."""
        counts = self.counts
        if adc <= 0.0:
            return 0.0
        # Written so that NaN gives the largest force, from which the force loop retracts.
        if not adc < counts[-1]:
            return self.forces_n[-1]
        above = bisect_right(counts, adc)
        high, force_high_n = counts[above], self.forces_n[above]
        low, force_low_n = (counts[above - 1], self.forces_n[above - 1]) if above else (0.0, 0.0)
        return force_low_n + (adc - low) / (high - low) * (force_high_n - force_low_n)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A calibration and how well it agrees with the pairs it was made from.

    Attributes
    ----------
    calibration
        The fitted table.
    residuals_n
        What the table makes of each pair's counts less the pair's force [N], in the order the pairs came; None where
        the converter was saturated.
    rms_n, max_n
        Root mean square and largest magnitude [N] of the residuals.
    hysteresis
        How much more the sensor seems to feel while unloading, as a fraction of the force: mean relative residual of
        the pairs whose force is lower than that of the pair before, less that of those where it is higher. None when
        the pairs, in the order they came, do not go both ways.
    """

    calibration: Calibration
    residuals_n: tuple[float | None, ...]
    rms_n: float
    max_n: float
    hysteresis: float | None


def fit_calibration(adc_counts: Sequence[float], forces_n: Sequence[float], *, knots: int = MOST_KNOTS) -> Fit:
    """Fit a calibration to measured pairs: the best of all monotone piecewise-linear tables with given knots.

    Best is the one with the least squares of residual over force: the sensor's own errors are a fraction of the force
    (hysteresis 10 %, FSR 400 series data sheet), and so is what a finger can tell.

    Pairs may be noisy, repeated, in any order, and taken while loading and unloading. A pair at 0 counts says nothing
    a table could use, because 0 counts are 0 N in any; it still has a residual. Saturated pairs are left out.

    Parameters
    ----------
    adc_counts
        Converter counts, 0 to 1023; means may have a fraction.
    forces_n
        The force [N] that was applied at each of them.
    knots
        Largest number of knots, 2 to 8. There are never more than there are different forces.

    Raises
    ------
    SettingsError
        If a value cannot be used, if too few pairs are left, or if the force does not grow with the counts.

    Examples
    --------
    >>> fit = fit_calibration([400, 200, 401, 199], [2.0, 0.5, 2.0, 0.5])
    >>> round(fit.calibration.force_n(300), 2)
    1.25
    """
    check_parameter("number of calibration knots", knots, 2, MOST_KNOTS)
    counts, forces = _checked(adc_counts, forces_n)
    measured = counts <= FULL_SCALE_COUNTS - 1.0
    usable = measured & (counts > 0.0)
    # Sorted, so that the order in which the pairs came cannot show in the last bits.
    order = np.lexsort((forces[usable], counts[usable]))
    sorted_counts, sorted_forces = counts[usable][order], forces[usable][order]
    _check_usable(sorted_counts, sorted_forces, saturated=len(counts) - int(measured.sum()))
    at = _knots(_whole(sorted_counts), min(knots, len(np.unique(sorted_forces))))
    heights = np.cumsum(_steps_n(at, sorted_counts, sorted_forces))
    calibration = Calibration(tuple(at.tolist()), tuple(heights.tolist()))
    residuals = np.array([calibration.force_n(adc) for adc in counts.tolist()]) - forces
    missed = np.sort(np.abs(residuals[measured]))
    return Fit(
        calibration=calibration,
        residuals_n=tuple(
            residual if known else None for residual, known in zip(residuals.tolist(), measured.tolist(), strict=True)
        ),
        rms_n=math.sqrt((missed**2).mean()),
        max_n=float(missed[-1]),
        hysteresis=_hysteresis(residuals[usable], forces[usable]),
    )


def _checked(adc_counts: Sequence[float], forces_n: Sequence[float]) -> tuple[Numbers, Numbers]:
    counts = np.asarray(adc_counts, dtype=np.float64)
    forces = np.asarray(forces_n, dtype=np.float64)
    if counts.ndim != 1 or counts.shape != forces.shape:
        raise SettingsError(f"calibration has {counts.size} counts and {forces.size} forces; it needs a force for each")
    for pair, (adc, force_n) in enumerate(zip(counts.tolist(), forces.tolist(), strict=True), start=1):
        check_parameter(f"pair {pair}: adc", adc, 0.0, FULL_SCALE_COUNTS, "counts")
        check_parameter(f"pair {pair}: force", force_n, 0.0, LARGEST_FORCE_N, "N")
    return counts, forces


def _whole(counts: Numbers) -> Numbers:
    """Return the whole counts, 1 or more, nearest to measured ones: what may become a knot."""
    return np.unique(np.maximum(np.rint(counts), 1.0))


def _check_usable(counts: Numbers, forces: Numbers, *, saturated: int) -> None:
    if len(np.unique(forces)) < 2 or len(_whole(counts)) < 2:
        raise SettingsError(
            f"{len(counts)} pairs can be used ({saturated} are saturated, and 0 counts say nothing); "
            "a calibration needs two different forces at least, and different counts for them"
        )
    if forces.max() < SENSOR_THRESHOLD_N:
        raise SettingsError(
            f"the largest force is {forces.max():g} N; the sensor detects nothing below {SENSOR_THRESHOLD_N} N"
        )
    if np.dot(counts - counts.mean(), forces - forces.mean()) <= 0.0:
        raise SettingsError(
            "the force does not grow with the counts; the sensor belongs between 5 V and A0, the resistor between "
            "A0 and ground"
        )


def _knots(candidates: Numbers, most: int) -> Numbers:
    """Return at most `most` of the candidates, the lowest and the highest among them.

    They are nearest to equal distances on ``arsinh √G``, with the sensor's conductance ``G = counts / (full scale +
    1 − counts)`` in units of the divider's: there straight lines miss a force that grows with G by the same fraction
    in every interval.
    """
    if len(candidates) <= most:
        return candidates
    scale = np.arcsinh(np.sqrt(candidates / (FULL_SCALE_COUNTS + 1.0 - candidates)))
    wanted = np.linspace(scale[0], scale[-1], most)
    nearest = np.abs(scale[:, np.newaxis] - wanted).argmin(axis=0)
    knots: Numbers = candidates[np.unique(nearest)]
    return knots


def _steps_n(knots: Numbers, counts: Numbers, forces: Numbers) -> Numbers:
    """Return the force [N] gained from each knot to the next, the first from 0 counts, by weighted least squares.

    Every step gets its least height; what comes on top must not be negative. The best such steps are the plain least
    squares of those that are not 0: with 8 knots at most, all 256 choices can be tried.
    """
    below = np.concatenate(([0.0], knots[:-1]))
    least: Numbers = FLATTEST_SLOPE * forces.max() / knots[-1] * (knots - below)
    shares = np.clip((counts[:, np.newaxis] - below) / (knots - below), 0.0, 1.0)
    weights = 1.0 / np.maximum(forces, SENSOR_THRESHOLD_N)
    # Thousands of pairs become as many equations as there are knots.
    rotation, triangle = np.linalg.qr(weights[:, np.newaxis] * shares)
    wanted = rotation.T @ (weights * (forces - shares @ least))
    best, smallest = np.zeros_like(knots), float(wanted @ wanted)
    for chosen in itertools.product((True, False), repeat=len(knots)):
        choice = np.flatnonzero(chosen)
        steps = np.zeros_like(knots)
        steps[choice] = np.linalg.lstsq(triangle[:, choice], wanted)[0]
        missed = wanted - triangle @ steps
        if steps.min() >= 0.0 and missed @ missed < smallest:
            best, smallest = steps, float(missed @ missed)
            if len(choice) == len(knots):
                break  # Nothing held it back, so nothing is better.
    return least + best


def _hysteresis(residuals: Numbers, forces: Numbers) -> float | None:
    change = np.diff(forces, prepend=forces[:1])
    felt = forces >= SENSOR_THRESHOLD_N
    loading, unloading = felt & (change > 0.0), felt & (change < 0.0)
    if not (loading.any() and unloading.any()):
        return None
    relative = residuals / np.maximum(forces, SENSOR_THRESHOLD_N)
    return float(relative[unloading].mean() - relative[loading].mean())
