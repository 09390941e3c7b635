"""Calibration of the force sensor: a monotone piecewise-linear table from counts to newtons, and its fit."""

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
LARGEST: Final = 1e6  # largest counts and newtons in a table, beyond any sensor
MOST_KNOTS: Final = 8  # follows a sensor with conductance linear in force within 3 % from 0.2 to 10 N
FULL_SCALE_COUNTS: Final = 1023.0  # of the ATmega328P's 10-bit converter; means within one of it were saturated in part
LARGEST_FORCE_N: Final = 100.0  # of a pair [N]: five times the range of the FSR 400 series (data sheet); catches grams
FLATTEST_SLOPE: Final = 0.01
"""Smallest slope of a fitted table, as a fraction of its mean slope: a flat table gives a force loop no signal.
A sensor linear in conductance is nowhere flatter than 5 % up to 20 N, so this limit affects only noise."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """A piecewise-linear table of converter counts and forces.

    Below the first pair the force falls linearly to 0 N at 0 counts. Above the last pair it is constant, because a
    sensor beyond its range gives only a lower bound. Raises SettingsError if there are fewer than two pairs, or a
    column is not finite, positive and strictly increasing.

    Examples
    --------
    >>> Calibration(counts=(100.0, 200.0), forces_n=(0.5, 2.5)).force_n(150)
    1.5
    """

    counts: tuple[float, ...]  # converter counts, positive and strictly increasing
    forces_n: tuple[float, ...]  # the force [N] at each count, positive and strictly increasing

    def __post_init__(self) -> None:
        if len(self.counts) != len(self.forces_n) or len(self.counts) < 2:
            raise SettingsError(
                f"calibration has {len(self.counts)} counts and {len(self.forces_n)} forces; "
                "it needs two or more of each, and the same number"
            )
        for name, column in (("counts", self.counts), ("forces [N]", self.forces_n)):
            for before, after in zip((0.0, *column), column, strict=False):
                if not before < after <= LARGEST:
                    raise SettingsError(
                        f"calibration {name} go from {before:g} to {after:g}; "
                        f"they must be above 0, strictly increasing and at most {LARGEST:g}"
                    )

    def force_n(self, adc: float) -> float:
        """Return the force [N] at a reading [counts]; averaged readings may have a fraction."""
        counts = self.counts
        if adc <= 0.0:
            return 0.0
        # NaN gives the largest force, from which the force loop retracts.
        if not adc < counts[-1]:
            return self.forces_n[-1]
        above = bisect_right(counts, adc)
        high, force_high_n = counts[above], self.forces_n[above]
        low, force_low_n = (counts[above - 1], self.forces_n[above - 1]) if above else (0.0, 0.0)
        return force_low_n + (adc - low) / (high - low) * (force_high_n - force_low_n)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A fitted calibration and its errors."""

    calibration: Calibration  # the fitted table
    # Force of the table at each pair's counts less the pair's force [N]; None where the converter was saturated
    residuals_n: tuple[float | None, ...]
    rms_n: float  # root mean square and largest magnitude [N] of the residuals
    max_n: float
    # Relative excess of the sensed force during unloading: the mean relative residual of the pairs with a lower force
    # than the pair before, less that of the pairs with a higher force. None without pairs of both kinds
    hysteresis: float | None


def fit_calibration(adc_counts: Sequence[float], forces_n: Sequence[float]) -> Fit:
    """Fit the best monotone piecewise-linear table with up to `MOST_KNOTS` knots to measured pairs.

    The fit minimizes the squared relative residuals, because the sensor's own errors are a fraction of the force
    (hysteresis 10 %, FSR 400 series data sheet), and so is the JND.

    Pairs may be noisy, repeated, in any order, and taken during loading and unloading. Pairs at 0 counts do not affect
    the table, in which 0 counts are always 0 N; they still have a residual. Saturated pairs are ignored.

    `adc_counts` are 0 to 1023; means may have a fraction.

    Raise SettingsError if a value is invalid, too few pairs are usable, or the force does not increase with the counts.

    Examples
    --------
    >>> fit = fit_calibration([400, 200, 401, 199], [2.0, 0.5, 2.0, 0.5])
    >>> round(fit.calibration.force_n(300), 2)
    1.25
    """
    counts, forces = _checked(adc_counts, forces_n)
    measured = counts <= FULL_SCALE_COUNTS - 1.0
    usable = measured & (counts > 0.0)
    # Sorted, so that the order of the pairs does not affect the last bits.
    order = np.lexsort((forces[usable], counts[usable]))
    sorted_counts, sorted_forces = counts[usable][order], forces[usable][order]
    _check_usable(sorted_counts, sorted_forces, saturated=len(counts) - int(measured.sum()))
    at = _knots(_whole(sorted_counts), min(MOST_KNOTS, len(np.unique(sorted_forces))))
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
    """Return the whole counts, 1 or more, nearest to measured ones: the candidates for knots."""
    return np.unique(np.maximum(np.rint(counts), 1.0))


def _check_usable(counts: Numbers, forces: Numbers, *, saturated: int) -> None:
    if len(np.unique(forces)) < 2 or len(_whole(counts)) < 2:
        raise SettingsError(
            f"{len(counts)} pairs are usable ({saturated} saturated; pairs at 0 counts are ignored); "
            "a calibration needs two or more different forces at different counts"
        )
    if forces.max() < SENSOR_THRESHOLD_N:
        raise SettingsError(
            f"the largest force is {forces.max():g} N; the sensor detects nothing below {SENSOR_THRESHOLD_N} N"
        )
    if np.dot(counts - counts.mean(), forces - forces.mean()) <= 0.0:
        raise SettingsError(
            "the force does not increase with the counts; connect the sensor between 5 V and A0 and the resistor "
            "between A0 and ground"
        )


def _knots(candidates: Numbers, most: int) -> Numbers:
    """Return at most `most` of the candidates, including the lowest and the highest.

    They are nearest to equal distances on ``arsinh √G``, with the sensor's conductance ``G = counts / (full scale +
    1 − counts)`` in units of the divider's. Straight lines then have the same relative error in every interval for a
    force that grows with G.
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

    Each step has a minimum height; the remainder must not be negative. The optimum is the plain least-squares solution
    for the remainders that are not 0, so with at most 8 knots all 256 subsets can be tried.
    """
    below = np.concatenate(([0.0], knots[:-1]))
    least: Numbers = FLATTEST_SLOPE * forces.max() / knots[-1] * (knots - below)
    shares = np.clip((counts[:, np.newaxis] - below) / (knots - below), 0.0, 1.0)
    weights = 1.0 / np.maximum(forces, SENSOR_THRESHOLD_N)
    # Reduce thousands of pairs to one equation per knot.
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
                break  # No constraint is active, so this is the optimum.
    return least + best


def _hysteresis(residuals: Numbers, forces: Numbers) -> float | None:
    change = np.diff(forces, prepend=forces[:1])
    felt = forces >= SENSOR_THRESHOLD_N
    loading, unloading = felt & (change > 0.0), felt & (change < 0.0)
    if not (loading.any() and unloading.any()):
        return None
    relative = residuals / np.maximum(forces, SENSOR_THRESHOLD_N)
    return float(relative[unloading].mean() - relative[loading].mean())
