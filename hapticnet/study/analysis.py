"""Results of the ordering task: shares of correct orders, pairs, times, bytes and ratings, and tests between them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import fmean

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import SettingsError
from hapticnet.experiment.conditions import CONDITIONS
from hapticnet.study.measures import MEASURES, TESTED, mean
from hapticnet.study.results import MARGIN, PAPER_ERRORS, Comparison, ConditionResult, Figure, Results
from hapticnet.study.rows import OrderRow
from hapticnet.study.statistics import (
    Leaving,
    equivalence,
    holm,
    leaving_point,
    mean_interval,
    sign_flip,
    standard_error,
    two_sided,
    wilson,
)


def analyse(rows: Sequence[OrderRow], *, margin: float = MARGIN, seed: int = 1) -> Results:
    """Return the results of the ordering task.

    Parameters
    ----------
    margin
        Difference in the share of correct orders below which a condition counts as equal to no compression.
    seed
        Seed of the resamples for the interval of the curve.

    Raises
    ------
    SettingsError
        If no trial was answered, or people and simulated observers are mixed.
    """
    trials = accepted(rows)
    if not trials:
        raise SettingsError("no answered trial of the ordering task was found")
    if len({row.observer is None for row in rows if row.event == "trial"}) > 1:
        raise SettingsError(
            "the folder has answers of people and of simulated observers; analyse them in folders apart"
        )
    participants = tuple(sorted({row.participant for row in trials}))
    ratings = [row for row in rows if row.event == "rating" and row.rating is not None]
    names = sorted({row.condition or "" for row in trials}, key=lambda name: _place(trials, name))
    conditions = tuple(
        _condition(
            [row for row in trials if row.condition == name],
            [row for row in ratings if row.condition == name],
            participants,
        )
        for name in names
    )
    return Results(
        simulated=tuple(sorted({row.observer for row in trials if row.observer})),
        participants=participants,
        conditions=conditions,
        comparisons=_comparisons(conditions, margin),
        margin=margin,
        curve=_curve(conditions, margin, seed),
        predictors=_predictors(conditions),
        repeated=sum(row.event == "repeated" for row in rows),
        aborted=sum(row.event == "aborted" for row in rows),
    )


def accepted(rows: Sequence[OrderRow]) -> list[OrderRow]:
    """Return the answered trials; of a trial that was written twice, the last."""
    last = {(row.participant, row.session, row.this_n): row for row in rows if row.event == "trial"}
    return list(last.values())


def _place(trials: Sequence[OrderRow], name: str) -> tuple[float, str]:
    first = next(row for row in trials if row.condition == name)
    return (0.0 if first.codec == "raw" else first.multiplier or 0.0), name


def _condition(trials: Sequence[OrderRow], ratings: Sequence[OrderRow], participants: Sequence[str]) -> ConditionResult:
    name = trials[0].condition or ""
    correct = sum(row.correct or 0 for row in trials)
    own = {person: [row for row in trials if row.participant == person] for person in participants}
    figures = {
        key: _figure([measure(own[person]) for person in participants]) for key, (_, measure) in MEASURES.items()
    }
    figures["rating"] = _figure(
        [mean(row.rating for row in ratings if row.participant == person) for person in participants]
    )
    paper = next((each for each in CONDITIONS if each.name == name), None)
    return ConditionResult(
        name=name,
        codec=trials[0].codec or "",
        multiplier=0.0 if trials[0].codec == "raw" else trials[0].multiplier or 0.0,
        trials=len(trials),
        correct=correct,
        interval=wilson(correct, len(trials)),
        figures=figures,
        pair_shares=_pair_shares(trials),
        paper_correct=paper.paper_correct if paper else None,
        paper_error=PAPER_ERRORS.get(name),
        paper_byte_reduction=paper.paper_byte_reduction if paper else None,
    )


def _pair_shares(trials: Sequence[OrderRow]) -> tuple[float, float, float]:
    told = [row for row in trials if row.order_true and row.order_answered]

    def share(softer: int, harder: int) -> float:
        right = [
            row.order_answered.index(row.order_true[softer]) < row.order_answered.index(row.order_true[harder])
            for row in told
            if row.order_answered and row.order_true
        ]
        return fmean(right) if right else math.nan

    return share(0, 1), share(1, 2), share(0, 2)


def _comparisons(conditions: Sequence[ConditionResult], margin: float) -> tuple[Comparison, ...]:
    """Return each condition less the first one, for each tested measure."""
    found: list[Comparison] = []
    reference, *others = conditions
    for key in TESTED:
        own: list[Comparison] = []
        for other in others:
            differences = np.array(other.figures[key].each) - np.array(reference.figures[key].each)
            differences = differences[np.isfinite(differences)]
            if not len(differences):
                continue
            probability, interval_90 = equivalence(differences, margin)
            own.append(
                Comparison(
                    measure=key,
                    condition=other.name,
                    reference=reference.name,
                    difference=float(differences.mean()),
                    interval=mean_interval(differences),
                    probability=two_sided(sign_flip(differences)),
                    adjusted=1.0,
                    within_margin=probability,
                    margin=margin,
                    interval_90=interval_90,
                    participants=len(differences),
                )
            )
        adjusted = holm([each.probability for each in own])
        found += [_adjust(each, value) for each, value in zip(own, adjusted, strict=True)]
    return tuple(found)


def _adjust(comparison: Comparison, adjusted: float) -> Comparison:
    return replace(comparison, adjusted=adjusted)


def _curve(conditions: Sequence[ConditionResult], margin: float, seed: int) -> Leaving | None:
    """Return where the share of correct orders leaves the margin; conditions of other codecs are left out."""
    codecs = [each.codec for each in conditions if each.codec != "raw"]
    along = [each for each in conditions if each.codec == "raw" or each.codec == (codecs or [""])[0]]
    values = [each.multiplier for each in along]
    if len(along) < 3 or along[0].multiplier != 0.0 or len(set(values)) < len(values):
        return None
    scores = np.array([each.figures["correct"].each for each in along]).T
    scores = scores[np.isfinite(scores).all(axis=1)]
    return leaving_point(values, scores, margin, np.random.default_rng(seed)) if len(scores) > 1 else None


def _predictors(conditions: Sequence[ConditionResult]) -> dict[str, float]:
    """Return the correlation of ratings with objective measures, each about its participant's mean."""
    ratings = _centred(np.array([each.figures["rating"].each for each in conditions]))
    found = {}
    objective = {
        key: np.array([each.figures[key].each for each in conditions])
        for key in ("packets", "bytes", "correct", "delivered")
    }
    objective["threshold"] = np.array([[each.multiplier] * len(each.figures["correct"].each) for each in conditions])
    for key, values in objective.items():
        centred = _centred(values)
        known = np.isfinite(ratings) & np.isfinite(centred)
        if known.sum() > 2 and ratings[known].std() > 0.0 and centred[known].std() > 0.0:
            found[key] = float(np.corrcoef(ratings[known], centred[known])[0, 1])
    return found


def _centred(values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    counts = np.maximum(known.sum(axis=0, keepdims=True), 1)
    return np.asarray(values - np.where(known, values, 0.0).sum(axis=0, keepdims=True) / counts)


def _figure(each: Sequence[float | None]) -> Figure:
    known = [value for value in each if value is not None]
    return Figure(
        mean=fmean(known) if known else None,
        error=standard_error(known),
        each=tuple(math.nan if value is None else float(value) for value in each),
    )
