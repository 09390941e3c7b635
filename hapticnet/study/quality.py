"""Quality of experience: which objective measures of a block predict the rating that a participant gave it.

After Chaudhari, Steinbach & Hirche, "Towards an objective quality evaluation framework for haptic data reduction",
World Haptics Conference 2011, who mapped force errors by psychophysical laws and related them to ratings.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.study.results import ConditionResult, Predictor
from hapticnet.study.statistics import sign_flip, two_sided

OBJECTIVE: Final[dict[str, str]] = {
    "error": "perceptual error of the held force",
    "threshold": "threshold [JND]",
    "packets": "ln of packets per penetration",
    "bytes": "ln of bytes per penetration",
    "delivered": "sensed over held peak",
    "correct": "correct orders",
    "time_s": "time from contact to answer",
}
"""Measures that may predict a rating: name in `measures.MEASURES`, or the threshold, and name in reports."""

LOGARITHMIC: Final = ("packets", "bytes")


def predictors(conditions: Sequence[ConditionResult]) -> tuple[Predictor, ...]:
    """Return how well each objective measure predicts the ratings, best first.

    Ratings and measures are taken about the mean of their participant, since participants use a scale differently.
    A measure that does not vary, or has fewer than three pairs, is left out.
    """
    ratings = _centred(np.array([each.figures["rating"].each for each in conditions]))
    found = [_predictor(name, ratings, _values(name, conditions)) for name in OBJECTIVE]
    known = [each for each in found if each is not None]
    return tuple(sorted(known, key=lambda each: -abs(each.correlation)))


def _values(name: str, conditions: Sequence[ConditionResult]) -> FloatArray:
    """Return a measure, shape (conditions, participants)."""
    if name == "threshold":
        return np.array([[each.multiplier] * len(each.figures["correct"].each) for each in conditions])
    values = np.array([each.figures[name].each for each in conditions])
    return np.log(np.maximum(values, 1e-9)) if name in LOGARITHMIC else values


def _predictor(name: str, ratings: FloatArray, values: FloatArray) -> Predictor | None:
    known = np.isfinite(ratings) & np.isfinite(values)
    ratings = _centred(np.where(known, ratings, np.nan))
    values = _centred(np.where(known, values, np.nan))
    if known.sum() < 3 or np.nanstd(ratings) < 1e-9 or np.nanstd(values) < 1e-9:
        return None
    # One covariance for each participant: under the null hypothesis its sign is as likely as the other.
    own = np.nansum(ratings * values, axis=0)[known.sum(axis=0) > 1]
    return Predictor(
        name=OBJECTIVE[name],
        correlation=float(np.corrcoef(ratings[known], values[known])[0, 1]),
        probability=two_sided(sign_flip(own / np.abs(own).max())) if np.abs(own).max() > 0.0 else 1.0,
        predicted=_predicted(ratings, values),
        participants=len(own),
    )


def _predicted(ratings: FloatArray, values: FloatArray) -> float:
    """Return the share of the variance of each participant's ratings that a line fitted to the others predicts."""
    errors = total = 0.0
    for person in range(ratings.shape[1]):
        others = np.delete(np.arange(ratings.shape[1]), person)
        spread = float(np.nansum(values[:, others] ** 2))
        if spread < 1e-12:
            return math.nan
        slope = float(np.nansum(ratings[:, others] * values[:, others])) / spread
        errors += float(np.nansum((ratings[:, person] - slope * values[:, person]) ** 2))
        total += float(np.nansum(ratings[:, person] ** 2))
    return 1.0 - errors / total if total > 0.0 else math.nan


def _centred(values: FloatArray) -> FloatArray:
    """Return values less the mean of their column, shape (conditions, participants); NaN is left out."""
    known = np.isfinite(values)
    counts = np.maximum(known.sum(axis=0, keepdims=True), 1)
    return np.asarray(values - np.where(known, values, 0.0).sum(axis=0, keepdims=True) / counts)
