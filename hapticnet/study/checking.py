"""Checks of the rows of a study before they are analysed: one design, one kind of participant, and what is missing."""

from collections import Counter
from collections.abc import Sequence

from hapticnet.errors import SettingsError
from hapticnet.study.flow import NO_CONSENT
from hapticnet.study.results import UsedLaw
from hapticnet.study.rows import OrderRow

APART = "analyse each in a folder of its own"


def accepted(rows: Sequence[OrderRow]) -> list[OrderRow]:
    """Return the trials with an answer; of a trial that was written twice, the last."""
    last = {(row.participant, row.session, row.this_n): row for row in rows if row.event == "trial"}
    return [row for row in last.values() if row.correct is not None]


def ratings_of(rows: Sequence[OrderRow]) -> list[OrderRow]:
    """Return the ratings of blocks with one condition; a rating of interleaved conditions is of none of them."""
    conditions: dict[tuple[str, int, int | None], set[str | None]] = {}
    for row in accepted(rows):
        conditions.setdefault((row.participant, row.session, row.block), set()).add(row.condition)
    return [
        row
        for row in rows
        if row.event == "rating"
        and row.rating is not None
        and len(conditions.get((row.participant, row.session, row.block), ())) <= 1
    ]


def check_design(rows: Sequence[OrderRow]) -> None:
    """Refuse rows whose trials do not belong to one study.

    Raises
    ------
    SettingsError
        If people and simulated observers are mixed, a condition or the tissues differ between trials, or an answer is
        none.
    """
    trials = accepted(rows)
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
        forces_n = tuple(sorted(row.breach_forces_n, key=lambda force_n: force_n or 0.0))
        tissues.setdefault(forces_n, row.participant)
    if len(tissues) > 1:
        told = "; ".join(f"{_listed(forces_n)} N (participant {person})" for forces_n, person in tissues.items())
        raise SettingsError(f"the folder mixes two designs: the breach forces are {told}; {APART}")


def _listed(values: Sequence[float | None]) -> str:
    return ", ".join("n/a" if value is None else f"{value:g}" for value in values)


def _check_answer(row: OrderRow) -> None:
    where = f"participant {row.participant}, session {row.session}, trial {row.this_n}:"
    if row.correct not in (0, 1):
        raise SettingsError(f"{where} key_resp.corr is {row.correct}; it must be 0 or 1")
    for column in ("order_true", "order_answered"):
        order = getattr(row, column)
        if order is not None and sorted(order) != list("123"):
            raise SettingsError(f"{where} {column} is {order[:20]!r}; it must have 1, 2 and 3 once each, such as 213")


def missing(rows: Sequence[OrderRow], trials: Sequence[OrderRow], conditions: Sequence[str]) -> tuple[str, ...]:
    """Return, as sentences, what is missing or uneven in the data."""
    told = []
    unanswered = len({(r.participant, r.session, r.this_n) for r in rows if r.event == "trial"}) - len(trials)
    if unanswered:
        told.append(
            "1 trial without an answer is left out."
            if unanswered == 1
            else f"{unanswered} trials without an answer are left out."
        )
    people = sorted({row.participant for row in trials})
    counts = Counter((row.participant, row.condition) for row in trials)
    for name in conditions:
        most = max(counts[person, name] for person in people)
        for person in people:
            own = counts[person, name]
            if own == 0:
                told.append(f"Participant {person} has no trial of {name} and is left out of comparisons with it.")
            elif own < most:
                told.append(f"Participant {person} has {own} trials of {name}; others have {most}.")
    ratings = ratings_of(rows)
    mixed = sum(row.event == "rating" and row.rating is not None for row in rows) - len(ratings)
    if mixed:
        told.append(f"{mixed} ratings of blocks with several conditions are left out.")
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


def laws_of(trials: Sequence[OrderRow]) -> tuple[UsedLaw, ...]:
    """Return what 1 JND was for each participant."""
    found = {
        UsedLaw(
            participant=row.participant,
            weber_fraction=row.weber_fraction,
            floor_n=row.floor_n,
            source=row.jnd_source or "unknown",
        )
        for row in trials
        if row.weber_fraction is not None and row.floor_n is not None
    }
    return tuple(sorted(found, key=lambda law: (law.participant, law.source)))
