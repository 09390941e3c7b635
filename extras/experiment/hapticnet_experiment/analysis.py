"""Results of the ordering task: shares of correct orders, pairs, times, bytes and ratings, and tests between them.

Rows are checked first: they must have one design and one kind of participant.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, median
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from hapticnet.errors import SettingsError
from hapticnet.experiment.analysis import CONDITIONS
from hapticnet_experiment.flow import NO_CONSENT
from hapticnet_experiment.observers import labelled
from hapticnet_experiment.rows import OrderRow
from hapticnet_experiment.statistics import (
    chance_variance,
    equivalence,
    holm,
    mean_interval,
    share_interval,
    sign_flip,
    standard_error,
    two_sided,
)

CHANCE: Final = 1 / 6  # share of correct orders by guessing
MARGIN: Final = 0.1  # default margin of equivalence: the plan's, which is stated before the study
# Standard errors of the share of correct orders in Fig. 5 of "Cutaneous haptic deadband compression".
PAPER_ERRORS: Final = {"none": 0.075, "1 JND": 0.056, "2 JND": 0.049, "4 JND": 0.065}
APART: Final = "analyse each in a separate folder"
Interval: TypeAlias = tuple[float, float]


class Measure(NamedTuple):
    """A measure of one participant's trials, or of the ratings, and its presentation."""

    name: str
    of: Callable[[Sequence[OrderRow]], float | None]  # None if not in the rows
    form: str = "{:.1f}"
    factor: float = 1.0


def mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of the known values; None without any."""
    known = [value for value in values if value is not None]
    return fmean(known) if known else None


def _mean_of(attribute: str) -> Callable[[Sequence[OrderRow]], float | None]:
    return lambda rows: mean(getattr(row, attribute) for row in rows)


def _per_penetration(attribute: str) -> Callable[[Sequence[OrderRow]], float | None]:
    def measured(rows: Sequence[OrderRow]) -> float | None:
        told = [row for row in rows if getattr(row, attribute) is not None and row.penetrations]
        through = sum(row.penetrations or 0 for row in told)
        return sum(getattr(row, attribute) for row in told) / through if through else None

    return measured


def _delivered(rows: Sequence[OrderRow]) -> float | None:
    """Return the mean share of the held peak that was sensed."""
    return mean(
        sensed / held
        for row in rows
        for held, sensed in zip(row.peaks_held_n, row.peaks_sensed_n, strict=True)
        if held and sensed is not None
    )


def _median_time(rows: Sequence[OrderRow]) -> float | None:
    times = [row.contact_to_answer_s for row in rows if row.contact_to_answer_s is not None]
    return median(times) if times else None


def _right_pairs(rows: Sequence[OrderRow]) -> float | None:
    return mean(row.pairs_correct / 3 for row in rows if row.pairs_correct is not None)


MEASURES: Final = {  # the rating uses the rows of ratings, the others the trials
    "correct": Measure("correct orders", _mean_of("correct"), "{:.1f} %", 100.0),
    "pairs": Measure("correct pairs", _right_pairs, "{:.1f} %", 100.0),
    "bytes": Measure("bytes per penetration", _per_penetration("penetration_bytes"), "{:,.0f}"),
    "packets": Measure("packets per penetration", _per_penetration("penetration_packets"), "{:,.1f}"),
    "time_s": Measure("time from contact to answer [s]", _median_time),
    "insertions": Measure("insertions", _mean_of("insertions")),
    "penetrations": Measure("penetrations", _mean_of("penetrations")),
    "peak_n": Measure(
        "force at contact: largest sensed [N]",
        lambda rows: mean(max((peak or 0.0) for peak in row.peaks_sensed_n) for row in rows),
        "{:.2f}",
    ),
    "delivered": Measure("sensed over held peak", _delivered, "{:.0f} %", 100.0),
    "error": Measure("perceptual error of the held force", _mean_of("perceptual_error"), "{:.3f}"),
    "speed_m_per_s": Measure("largest speed in contact", _mean_of("peak_speed_m_per_s"), "{:.0f} mm/s", 1000.0),
    "rating": Measure("rating, 1 to 7", _mean_of("rating"), "{:.2f}"),
}

SHARES: Final = "correct", "pairs"  # from 0 to 1
# Measures compared between conditions; the first has a margin of equivalence.
COMPARED: Final = "correct", "pairs", "time_s", "insertions", "peak_n", "rating"


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A measure of one condition, over participants."""

    mean: float | None  # None without data
    error: float | None  # standard error, n − 1
    each: tuple[float, ...]  # of each participant, in their order; NaN where missing


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionResult:
    """Results of one condition. Intervals are 95 % intervals over participants."""

    name: str
    codec: str
    multiplier: float  # threshold [JND]
    trials: int  # answered
    correct: int  # with the whole order right
    interval: Interval  # of their share
    figures: dict[str, Figure]  # by the name of the measure
    pair_shares: tuple[float, ...]  # right answers about softest–middle, middle–hardest, softest–hardest
    pair_intervals: tuple[Interval, ...]
    paper_correct: float | None  # the paper's figures for the condition of this name
    paper_error: float | None
    paper_byte_reduction: float | None

    @property
    def share(self) -> float:
        """Share of correct orders."""
        return self.correct / self.trials if self.trials else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A condition minus the reference, over the participants with both. The last three are only for correct orders."""

    measure: str
    condition: str
    reference: str
    difference: float
    interval: Interval  # 95 %
    probability: float  # two-sided, from the exact sign-flip test
    adjusted: float  # the same after Holm, for the comparisons of this measure
    participants: int
    within_margin: float | None = None  # probability of the two one-sided tests of equivalence
    interval_90: Interval | None = None  # of these tests
    equivalent: bool | None = None  # whether tests and interval both show equivalence


@dataclass(frozen=True, slots=True, kw_only=True)
class UsedLaw:
    """A participant's JND: Weber fraction, smallest JND [N], and their source."""

    participant: str
    weber_fraction: float
    floor_n: float
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """Results of a study."""

    simulated: tuple[str, ...]  # names of the simulated observers; empty if all answers are from people
    participants: tuple[str, ...]  # with trials
    conditions: tuple[ConditionResult, ...]
    comparisons: tuple[Comparison, ...]
    margin: float
    repeated: int  # trials that were not accepted
    aborted: int
    missing: tuple[str, ...] = ()  # sentences about missing or unbalanced data
    laws: tuple[UsedLaw, ...] = ()  # several for a participant whose sessions had different laws


def analyse(rows: Sequence[OrderRow], *, margin: float = MARGIN) -> Results:
    """Return the results of the ordering task.

    A condition counts as equal to no compression below a difference of `margin` in the share of correct orders. Raise
    SettingsError if no trial was answered, or the trials belong to two designs or to people and observers.
    """
    trials = accepted(rows)
    if not trials:
        raise SettingsError("no answered trial of the ordering task was found")
    _check_design(rows, trials)
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
        simulated=tuple(sorted({labelled(row.observer) for row in trials if row.observer})),
        participants=participants,
        conditions=conditions,
        comparisons=_comparisons(conditions, margin),
        margin=margin,
        repeated=sum(row.event == "repeated" for row in rows),
        aborted=sum(row.event == "aborted" for row in rows),
        missing=_missing(rows, trials, ratings, names),
        laws=_laws(trials),
    )


def accepted(rows: Sequence[OrderRow]) -> list[OrderRow]:
    """Return the trials with an answer; if a trial was written twice, the last row."""
    last = {(row.participant, row.session, row.this_n): row for row in rows if row.event == "trial"}
    return [row for row in last.values() if row.correct is not None]


def _check_design(rows: Sequence[OrderRow], trials: Sequence[OrderRow]) -> None:
    for row in trials:
        _check_answer(row)
    if len({row.observer is None for row in rows if row.event == "trial"}) > 1:
        raise SettingsError(f"the folder has answers of people and of simulated observers; {APART}")
    treated: dict[str, tuple[str, float]] = {}
    tissues: dict[tuple[float | None, ...], str] = {}
    for row in trials:
        name, treatment = row.condition or "", (row.codec or "", row.multiplier or 0.0)
        seen = treated.setdefault(name, treatment)
        if seen != treatment:
            told = " and ".join(f"{codec} at {multiplier:g} JND" for codec, multiplier in (seen, treatment))
            raise SettingsError(f"the folder mixes two designs: condition {name!r} is {told}; {APART}")
        tissues.setdefault(tuple(sorted(row.breach_forces_n, key=lambda force_n: force_n or 0.0)), row.participant)
    if len(tissues) > 1:
        told = "; ".join(
            f"{', '.join('n/a' if each is None else f'{each:g}' for each in forces_n)} N (participant {person})"
            for forces_n, person in tissues.items()
        )
        raise SettingsError(f"the folder mixes two designs: the breach forces are {told}; {APART}")


def _check_answer(row: OrderRow) -> None:
    where = f"participant {row.participant}, session {row.session}, trial {row.this_n}:"
    if row.correct not in (0, 1):
        raise SettingsError(f"{where} key_resp.corr is {row.correct}; it must be 0 or 1")
    for column in ("order_true", "order_answered"):
        order = getattr(row, column)
        if order is not None and sorted(order) != list("123"):
            raise SettingsError(f"{where} {column} is {order[:20]!r}; it must have 1, 2 and 3 once each, such as 213")


def _missing(
    rows: Sequence[OrderRow], trials: Sequence[OrderRow], ratings: Sequence[OrderRow], conditions: Sequence[str]
) -> tuple[str, ...]:
    """Return sentences about missing or unbalanced data."""
    told = []
    unanswered = len({(r.participant, r.session, r.this_n) for r in rows if r.event == "trial"}) - len(trials)
    if unanswered:
        told.append(f"Trials without an answer, omitted: {unanswered}.")
    people = sorted({row.participant for row in trials})
    counts = Counter((row.participant, row.condition) for row in trials)
    for name in conditions:
        most = max(counts[person, name] for person in people)
        for person in people:
            own = counts[person, name]
            if own == 0:
                told.append(f"Participant {person} has no trial of {name} and is omitted from comparisons with it.")
            elif own < most:
                told.append(f"Participant {person} has {own} trials of {name}; others have {most}.")
    rated = {(row.participant, row.condition) for row in ratings}
    unrated = sorted({person for person, name in counts if (person, name) not in rated})
    if rated and unrated:
        told.append(f"Ratings are missing of participants {', '.join(unrated)}.")
    declined = {row.participant for row in rows if row.event == "end" and row.reason == NO_CONSENT} - set(people)
    if declined:
        told.append(f"Participants {', '.join(sorted(declined))} did not agree to take part.")
    started = {row.participant for row in rows} - set(people) - declined
    if started:
        told.append(f"Participants {', '.join(sorted(started))} have no answered trial.")
    return tuple(told)


def _laws(trials: Sequence[OrderRow]) -> tuple[UsedLaw, ...]:
    found = {
        (row.participant, row.jnd_source or "unknown", row.weber_fraction, row.floor_n)
        for row in trials
        if row.weber_fraction is not None and row.floor_n is not None
    }
    return tuple(
        UsedLaw(participant=person, weber_fraction=fraction, floor_n=floor_n, source=source)
        for person, source, fraction, floor_n in sorted(found)
    )


def _place(trials: Sequence[OrderRow], name: str) -> tuple[float, str]:
    first = next(row for row in trials if row.condition == name)
    return (0.0 if first.codec == "raw" else first.multiplier or 0.0), name


def _condition(trials: Sequence[OrderRow], ratings: Sequence[OrderRow], participants: Sequence[str]) -> ConditionResult:
    name = trials[0].condition or ""
    pairs = [_pair(trials, participants, softer, harder) for softer, harder in ((0, 1), (1, 2), (0, 2))]
    correct = sum(row.correct or 0 for row in trials)
    own = {person: [row for row in trials if row.participant == person] for person in participants}
    given = {person: [row for row in ratings if row.participant == person] for person in participants}
    figures = {
        key: _figure([measure.of((given if key == "rating" else own)[person]) for person in participants])
        for key, measure in MEASURES.items()
    }
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


def _pair(trials: Sequence[OrderRow], participants: Sequence[str], softer: int, harder: int) -> tuple[float, Interval]:
    """Return the share of right answers about two tissues, and its interval over participants."""
    right: dict[str, list[int]] = {}
    for row in trials:
        if row.order_true and row.order_answered:
            place = row.order_answered.index
            own = right.setdefault(row.participant, [])
            own.append(place(row.order_true[softer]) < place(row.order_true[harder]))
    answers = [each for person in participants for each in right.get(person, ())]
    shares = [fmean(own) for own in right.values()]
    return fmean(answers) if answers else math.nan, share_interval(sum(answers), len(answers), shares)


def _comparisons(conditions: Sequence[ConditionResult], margin: float) -> tuple[Comparison, ...]:
    """Return each condition less the first one, for each tested measure."""
    found: list[Comparison] = []
    reference, *others = conditions
    for key in COMPARED:
        own = [each for other in others if (each := _comparison(key, reference, other, margin)) is not None]
        adjusted = holm([each.probability for each in own])
        found += [replace(each, adjusted=value) for each, value in zip(own, adjusted, strict=True)]
    return tuple(found)


def _comparison(key: str, reference: ConditionResult, other: ConditionResult, margin: float) -> Comparison | None:
    """Return the difference of one measure; None if no participant has both conditions."""
    differences = np.array(other.figures[key].each) - np.array(reference.figures[key].each)
    differences = differences[np.isfinite(differences)]
    if not len(differences):
        return None
    least = 0.0
    if key == "correct":
        people = len(reference.figures[key].each)
        least = sum(chance_variance(each.correct, each.trials, people) for each in (reference, other))
    probability = two_sided(sign_flip(differences))
    comparison = Comparison(
        measure=key,
        condition=other.name,
        reference=reference.name,
        difference=float(differences.mean()),
        interval=_bounded(key, mean_interval(differences, least_variance=least)),
        probability=probability,
        adjusted=probability,
        participants=len(differences),
    )
    if key != "correct":
        return comparison
    within, interval_90, shown = equivalence(differences, margin, least_variance=least)
    return replace(comparison, within_margin=within, interval_90=_bounded(key, interval_90), equivalent=shown)


def _bounded(measure: str, interval: Interval) -> Interval:
    """Return an interval of a difference limited to possible differences of shares; infinite ones mean "unknown"."""
    if measure not in SHARES or not all(map(math.isfinite, interval)):
        return interval
    return max(interval[0], -1.0), min(interval[1], 1.0)


def _figure(each: Sequence[float | None]) -> Figure:
    known = [value for value in each if value is not None]
    return Figure(
        mean=fmean(known) if known else None,
        error=standard_error(known),
        each=tuple(math.nan if value is None else float(value) for value in each),
    )
