"""Results of the ordering task: shares of correct orders, pairs, times, bytes and ratings, and tests between them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import fmean

import numpy as np

from hapticnet.errors import SettingsError
from hapticnet.experiment.conditions import CONDITIONS
from hapticnet.study.checking import accepted, check_design, laws_of, missing, ratings_of
from hapticnet.study.measures import COMPARED, MEASURES, SHARES, WITH_MARGIN, mean
from hapticnet.study.observers import labelled
from hapticnet.study.quality import predictors
from hapticnet.study.results import MARGIN, PAPER_ERRORS, Comparison, ConditionResult, Figure, Results
from hapticnet.study.rows import OrderRow
from hapticnet.study.statistics import (
    Leaving,
    chance_variance,
    equivalence,
    holm,
    leaving_point,
    mean_interval,
    share_interval,
    shows_equivalence,
    sign_flip,
    standard_error,
    two_sided,
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
        If no trial was answered, or the trials belong to two designs or to people and simulated observers.
    """
    trials = accepted(rows)
    if not trials:
        raise SettingsError("no answered trial of the ordering task was found")
    check_design(rows)
    participants = tuple(sorted({row.participant for row in trials}))
    ratings = ratings_of(rows)
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
        simulated=tuple(sorted({labelled(row.observer) for row in trials if row.observer})),
        participants=participants,
        conditions=conditions,
        comparisons=_comparisons(conditions, margin),
        margin=margin,
        curve=_curve(conditions, margin, seed),
        predictors=predictors(conditions),
        repeated=sum(row.event == "repeated" for row in rows),
        aborted=sum(row.event == "aborted" for row in rows),
        missing=missing(rows, trials, names),
        laws=laws_of(trials),
    )


def _place(trials: Sequence[OrderRow], name: str) -> tuple[float, str]:
    first = next(row for row in trials if row.condition == name)
    return (0.0 if first.codec == "raw" else first.multiplier or 0.0), name


def _condition(trials: Sequence[OrderRow], ratings: Sequence[OrderRow], participants: Sequence[str]) -> ConditionResult:
    name = trials[0].condition or ""
    pairs = _pairs(trials, participants)
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
        interval=share_interval(correct, len(trials), [each for each in figures["correct"].each if each == each]),
        figures=figures,
        pair_shares=tuple(share for share, _ in pairs),
        pair_intervals=tuple(interval for _, interval in pairs),
        paper_correct=paper.paper_correct if paper else None,
        paper_error=PAPER_ERRORS.get(name),
        paper_byte_reduction=paper.paper_byte_reduction if paper else None,
    )


def _pairs(trials: Sequence[OrderRow], participants: Sequence[str]) -> list[tuple[float, tuple[float, float]]]:
    """Return for each pair of tissues the share of right answers and its interval over participants."""

    def told(softer: int, harder: int) -> tuple[float, tuple[float, float]]:
        right: dict[str, list[int]] = {}
        for row in trials:
            if row.order_true and row.order_answered:
                place = row.order_answered.index
                own = right.setdefault(row.participant, [])
                own.append(place(row.order_true[softer]) < place(row.order_true[harder]))
        answers = [each for person in participants for each in right.get(person, ())]
        shares = [fmean(own) for own in right.values()]
        return fmean(answers) if answers else math.nan, share_interval(sum(answers), len(answers), shares)

    return [told(0, 1), told(1, 2), told(0, 2)]


def _comparisons(conditions: Sequence[ConditionResult], margin: float) -> tuple[Comparison, ...]:
    """Return each condition less the first one, for each tested measure."""
    found: list[Comparison] = []
    reference, *others = conditions
    for key in COMPARED:
        own: list[Comparison] = []
        for other in others:
            differences = np.array(other.figures[key].each) - np.array(reference.figures[key].each)
            differences = differences[np.isfinite(differences)]
            if not len(differences):
                continue
            least = 0.0
            if key in WITH_MARGIN:
                people = len(reference.figures[key].each)
                least = sum(chance_variance(each.correct, each.trials, people) for each in (reference, other))
            within, interval_90 = (
                equivalence(differences, margin, least_variance=least) if key in WITH_MARGIN else (None, None)
            )
            own.append(
                Comparison(
                    measure=key,
                    condition=other.name,
                    reference=reference.name,
                    difference=float(differences.mean()),
                    interval=_bounded(key, mean_interval(differences, least_variance=least)),
                    probability=two_sided(sign_flip(differences)),
                    adjusted=1.0,
                    within_margin=within,
                    interval_90=None if interval_90 is None else _bounded(key, interval_90),
                    equivalent=(
                        None
                        if within is None or interval_90 is None
                        else shows_equivalence(within, interval_90, margin)
                    ),
                    participants=len(differences),
                )
            )
        adjusted = holm([each.probability for each in own])
        found += [_adjust(each, value) for each, value in zip(own, adjusted, strict=True)]
    return tuple(found)


def _bounded(measure: str, interval: tuple[float, float]) -> tuple[float, float]:
    """Return an interval of a difference without what a difference of shares cannot be; infinite ones say "unknown"."""
    if measure not in SHARES or not all(map(math.isfinite, interval)):
        return interval
    return max(interval[0], -1.0), min(interval[1], 1.0)


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


def _figure(each: Sequence[float | None]) -> Figure:
    known = [value for value in each if value is not None]
    return Figure(
        mean=fmean(known) if known else None,
        error=standard_error(known),
        each=tuple(math.nan if value is None else float(value) for value in each),
    )
