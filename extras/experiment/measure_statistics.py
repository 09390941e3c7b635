"""Test the statistics of the study on answers with a known truth: exclusions, coverage of intervals, power.

::

    python measure_statistics.py --out results/study

observers.md has the tables. No person takes part.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from scipy.optimize import brentq

from hapticnet.arrays import FloatArray
from hapticnet.errors import SettingsError
from hapticnet.experiment.analysis import CONDITIONS
from hapticnet.experiment.provenance import provenance
from hapticnet_experiment.observers import OBSERVERS, Observer
from hapticnet_experiment.plan import LimitsPlan, Plan
from hapticnet_experiment.procedure import Procedure, Question
from hapticnet_experiment.schedule import LimitsSchedule
from hapticnet_experiment.statistics import (
    ALPHA,
    chance_variance,
    equivalence,
    mean_interval,
    share_interval,
    sign_flip,
)
from hapticnet_experiment.weber import fit, participant_file

Answers: TypeAlias = Callable[[Question], str]
"""Answers a question, such as "same" or "2"."""

Subject: TypeAlias = Callable[[np.random.Generator], Answers]
"""Makes one participant."""


def honest(criterion: float) -> Subject:
    """Return observers who say "different" above a criterion in standard deviations; each has its own noise."""

    def make(rng: np.random.Generator) -> Answers:
        settings = replace(OBSERVERS["literature"], criterion=criterion).of_participant(rng)
        observer = Observer(settings, rng)
        return lambda question: "different" if observer.different(*question.forces_n) else "same"

    return make


def at_random(share: float) -> Subject:
    """Return participants who say "different" in a share of all pairs, whatever the forces are."""
    return lambda rng: lambda _: "different" if rng.random() < share else "same"


def chooser(rng: np.random.Generator) -> Answers:
    """Return an honest observer of a forced choice."""
    observer = Observer(OBSERVERS["literature"].of_participant(rng), rng)
    return lambda question: str(observer.stronger(*question.forces_n))


def guesser(rng: np.random.Generator) -> Answers:
    """Return a participant who guesses in a forced choice."""
    return lambda _: str(rng.integers(1, 3))


SUBJECTS: Final[dict[str, tuple[str, Subject]]] = {
    "honest, criterion 1.64 sd": ("ascending", honest(1.64)),
    "honest, criterion 2.33 sd": ("ascending", honest(2.33)),
    '"different" at random, 1 in 2': ("ascending", at_random(0.5)),
    '"different" at random, 1 in 5': ("ascending", at_random(0.2)),
    "honest, up-down": ("up-down", chooser),
    "at random, up-down": ("up-down", guesser),
}


def _procedure(plan: Plan, number: int) -> Procedure:
    schedule = LimitsSchedule.draw(plan, f"{number}", 1, 1)
    return Procedure(plan.limits, schedule.series, schedule.intervals)


def rules(people: int) -> list[dict[str, Any]]:
    """Return how many of each kind of participant the default plan excludes, and the JND of the others."""
    rows: list[dict[str, Any]] = []
    for name, (method, subject) in SUBJECTS.items():
        plan = Plan(limits=LimitsPlan(method=method))  # type: ignore[arg-type]
        excluded, kept, pairs = 0, [], []
        for number in range(1, people + 1 if method == "ascending" else people // 5 + 1):
            rng = np.random.default_rng([9, number, len(rows)])
            procedure = _procedure(plan, number)
            answer, asked = subject(rng), 0
            while (question := procedure.question()) is not None:
                asked += 1
                procedure.answer(answer(question))
            counts = {key: getattr(procedure, key, None) for key in ("false_alarms", "catch_pairs")}
            pairs.append(asked)
            try:
                found = participant_file(
                    f"{number}", plan.limits, procedure.by_reference(), device_errors_n={}, **counts
                )
            except SettingsError:  # no JND was found
                excluded += 1
                continue
            excluded += bool(found.excluded)
            if not found.excluded:
                kept.append(found.weber_fraction)
        rows.append(
            {
                "subject": name,
                "people": len(pairs),
                "excluded": excluded / len(pairs),
                "weber_fraction_of_the_others": float(np.mean(kept)) if kept else None,
                "pairs": float(np.mean(pairs)),
            }
        )
    return rows


def jnd_intervals(people: int) -> list[dict[str, Any]]:
    """Return how often the interval of a JND contains the same observer's mean over infinitely many series."""
    rows: list[dict[str, Any]] = []
    for criterion in (1.0, 1.64, 2.33):
        for repetitions in (3, 5, 10):
            plan = Plan(limits=LimitsPlan(repetitions=repetitions))
            fits = []
            for number in range(1, people + 1):
                rng = np.random.default_rng([10, number, len(rows)])
                observer = Observer(replace(OBSERVERS["literature"], criterion=criterion), rng)
                procedure = _procedure(plan, number)
                while (question := procedure.question()) is not None:
                    procedure.answer("different" if observer.different(*question.forces_n) else "same")
                fits.append(fit(procedure.by_reference()))
            truth = float(np.mean([each.mean_of_ratios for each in fits]))
            inside = [each.low is not None and each.low <= truth <= (each.high or 0.0) for each in fits]
            rows.append({"criterion": criterion, "series": repetitions, "covered": float(np.mean(inside))})
    return rows


SPREAD: Final = 0.7  # standard deviation over participants of the log odds of a correct order: an assumption


def scores_of(
    shares: Sequence[float], spread: float, size: tuple[int, int, int], rng: np.random.Generator
) -> FloatArray:
    """Return the shares of correct orders of people who are right in given mean shares of the trials.

    `size` are experiments, people and trials of each condition; the shape is (experiments, people, conditions).
    """
    experiments, people, trials = size
    nodes, weights = np.polynomial.hermite_e.hermegauss(31)

    def excess(log_odds: float, share: float) -> float:
        return float(weights @ (1.0 / (1.0 + np.exp(-(log_odds + spread * nodes))))) / float(weights.sum()) - share

    log_odds = [brentq(excess, -10.0, 10.0, args=(share,)) for share in shares]
    own = rng.normal(0.0, spread, (experiments, people, 1))
    scores: FloatArray = rng.binomial(trials, 1.0 / (1.0 + np.exp(-(own + log_odds)))) / trials
    return scores


def power(experiments: int) -> list[dict[str, Any]]:
    """Return how often the tests find what the paper's shares would be, for several designs."""
    rows, shares = [], [each.paper_correct for each in CONDITIONS]
    for people, trials in ((8, 10), (16, 10), (16, 20), (24, 20)):
        rng = np.random.default_rng([13, people, trials])
        found = np.zeros((experiments, len(shares), 3))  # differ, equivalent within 0.1, half width
        for index, own in enumerate(scores_of(shares, SPREAD, (experiments, people, trials), rng)):
            right = np.rint(trials * own.sum(axis=0)).astype(int).tolist()
            for condition in range(1, len(shares)):
                differences = own[:, condition] - own[:, 0]
                least = sum(chance_variance(right[each], people * trials, people) for each in (0, condition))
                low, high = mean_interval(differences, least_variance=least)
                *_, is_equivalent = equivalence(differences, 0.1, least_variance=least)
                differ = 2.0 * min(sign_flip(differences)) < ALPHA
                found[index, condition] = differ, is_equivalent, (high - low) / 2
        for treated, figures in zip(CONDITIONS[1:], found.mean(axis=0)[1:].tolist(), strict=True):
            named = dict(zip(("differ", "equivalent", "half_width"), figures, strict=True))
            rows.append({"people": people, "trials": trials, "condition": treated.name, **named})
    return rows


def order_intervals(experiments: int) -> list[dict[str, Any]]:
    """Return how often intervals of the ordering task contain the truth, for several shares, spreads and designs."""
    rows: list[dict[str, Any]] = []
    for people, trials in ((8, 10), (16, 20)):
        for spread in (0.0, SPREAD):
            for shares in ((0.775, 0.775), (0.775, 0.5375), (0.97, 0.87)):
                rng = np.random.default_rng([11, len(rows)])
                true = shares[1] - shares[0]
                inside = np.zeros((experiments, 2))
                for index, scores in enumerate(scores_of(shares, spread, (experiments, people, trials), rng)):
                    right = np.rint(trials * scores.sum(axis=0)).astype(int).tolist()
                    of_share = share_interval(right[0], people * trials, scores[:, 0])
                    least = sum(chance_variance(each, people * trials, people) for each in right)
                    differences = scores[:, 1] - scores[:, 0]
                    of_difference = mean_interval(differences, least_variance=least)
                    found = ((of_share, shares[0]), (of_difference, true))
                    inside[index] = [low <= truth <= high for (low, high), truth in found]
                covered = dict(zip(("share", "difference"), inside.mean(axis=0).tolist(), strict=True))
                rows.append({"people": people, "trials": trials, "spread": spread, "shares": shares, **covered})
    return rows


def tables(result: dict[str, Any]) -> list[str]:
    """Return the rules as a table of Markdown, and a line of JSON for each design of the intervals."""
    lines = ["| participants | excluded | Weber fraction of the others | pairs |", "|---|---|---|---|"]
    for row in result["rules"]:
        fraction = row["weber_fraction_of_the_others"]
        cells = (
            f"{100 * row['excluded']:.1f} %",
            "–" if fraction is None else f"{fraction:.3f}",
            f"{row['pairs']:.0f}",
        )
        lines.append(f"| {row['subject']} | {' | '.join(cells)} |")
    lines += ["", *(json.dumps(row) for name in ("jnd", "order", "power") for row in result[name])]
    return lines


def main() -> None:
    """Simulate, print the tables and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=1000, help="participants of each kind")
    parser.add_argument("--out", type=Path, default=Path("results/study"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {
        "provenance": provenance(),
        "rules": rules(arguments.people),
        "jnd": jnd_intervals(arguments.people),
        "order": order_intervals(2 * arguments.people),
        "power": power(2 * arguments.people // 5),
    }
    (arguments.out / "study.json").write_text(json.dumps(result, indent=1) + "\n")
    print("\n".join(tables(result)))


if __name__ == "__main__":
    main()
