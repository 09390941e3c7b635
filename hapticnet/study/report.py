"""The report of a study in Markdown."""

import math
from collections.abc import Sequence
from statistics import fmean
from typing import Final

from hapticnet.study.models import Effect
from hapticnet.study.results import Results
from hapticnet.study.statistics import ALPHA, standard_error
from hapticnet.study.tables import (
    UNKNOWN,
    chance,
    condition_table,
    margin_table,
    number,
    other_table,
    people_table,
    signed,
)
from hapticnet.study.weber import ParticipantFile

LEAST_PARTICIPANTS: Final = 6
"""Participants below which no sign-flip test can find a difference at 5 %."""

JND_HEAD: Final = (
    "| participant | method | Weber fraction, mean of ratios | 95 % interval | through the origin | residual |"
    " false alarms | error of the device [N] | simulated |"
)

JND_NOTE: Final = (
    "Residual: root mean square of the relative deviations from Weber's law; false alarms: pairs of equal forces"
    " in catch series that were called different. The paper printed one JND per subject in newton, mean 0.05,"
    " SD 0.0076, without its reference forces or a Weber fraction."
)

COMPARED: Final = (
    "p: exact sign-flip test over participants, two-sided; Holm's adjustment is over the conditions of a measure."
    " Equivalence: two one-sided sign-flip tests with a margin of ±{margin:g} points{stated}. Intervals are"
    " Student's over participants, of orders never narrower than chance alone, so an interval and its test may"
    " disagree. Equivalence counts as shown only if p is below 0.05 and the 90 % interval lies within the margin."
)

PREDICTED: Final = (
    "p: exact sign-flip test of the participants' covariances. The share is of the ratings of each participant,"
    " predicted by a line fitted to the others; below 0 the participant's mean does better. After Chaudhari, Steinbach"
    " & Hirche (2011): the perceptual error is a root mean square of differences of logarithms of forces."
)

BYTES: Final = (
    "Bytes and packets per penetration are those from the touch of a tissue to its breach, keepalives and UDP and IPv4"
    " headers included, as in `hapticnet demo`; what is sent while nothing is touched, such as while the participant"
    " thinks, does not count. The saving grows with the rate of the samples and falls with the speed of the hand. The"
    " paper states neither, so its saving is a comparison, not a target; docs/benchmarks/tables.md has the saving over"
    " the rate, with the motion of the demo."
)

SIMULATED: Final = (
    "**No person took part.** A program answered in the place of each participant; docs/understand/observers.md says"
    " what such answers can show and what they cannot."
)

NO_PAPER_TEST: Final = (
    "The paper printed means and standard errors only. It made no test; every probability below is of this study."
)


def markdown(
    results: Results,
    *,
    title: str,
    figures: Sequence[str] = (),
    effects: Sequence[Effect] = (),
    models_note: str | None = None,
    people: Sequence[ParticipantFile] = (),
    origin: Sequence[str] = (),
    stated: str = "",
) -> str:
    """Return the report.

    Parameters
    ----------
    figures
        Names of the pictures beside the report.
    effects
        Coefficients of the models; `models_note` says why there are none.
    people
        The measured JNDs.
    origin
        Lines on version, date and machine.
    stated
        Where the margin of equivalence was stated, such as "stated in plan.toml".
    """
    simulated = f" – SIMULATED ({', '.join(results.simulated)})" if results.simulated else ""
    parts = [f"# {title}{simulated}", ""]
    if results.simulated:
        parts += [
            SIMULATED,
            "",
        ]
    parts += [_summary(results), "", *[f"- {line}" for line in results.missing], *([""] if results.missing else [])]
    parts += ["## Conditions", "", *condition_table(results), ""]
    parts += [
        "An interval of a share is of the share that participants like these would reach (Korn & Graubard 1998); the"
        " standard error (s.e.) is over participants, n − 1. " + NO_PAPER_TEST,
        "",
        BYTES,
        "",
        "Correct orders of each participant:",
        "",
        *people_table(results),
        "",
        *[line for name in figures if name.endswith(".png") for line in (f"![{_plain(name)}]({name})", "")],
        *_differences(results, stated),
        *_curve_section(results),
        *_quality(results),
        *_models(effects, models_note),
        *_laws(results),
        *_jnds(people),
        "## Origin",
        "",
        *[f"- {line}" for line in origin],
    ]
    return "\n".join(parts).rstrip() + "\n"


def jnd_markdown(people: Sequence[ParticipantFile], *, title: str, origin: Sequence[str] = ()) -> str:
    """Return the report of a study in which JNDs were measured and nothing was ordered yet."""
    simulated = sorted({each.simulated for each in people if each.simulated})
    parts = [
        f"# {title}" + (f" – SIMULATED ({', '.join(simulated)})" if simulated else ""),
        "",
        *([SIMULATED, ""] if simulated else []),
        "No trial of the ordering task was answered yet; these are the measured JNDs.",
        "",
        *_jnds(people),
        "## Origin",
        "",
        *[f"- {line}" for line in origin],
    ]
    return "\n".join(parts).rstrip() + "\n"


def _summary(results: Results) -> str:
    people = f"{len(results.participants)} participant{'s' if len(results.participants) > 1 else ''}"
    trials = sum(each.trials for each in results.conditions)
    return (
        f"{people}, {trials} answered trials in {len(results.conditions)} conditions; {results.repeated} trials were"
        f" repeated because the device did not deliver, {results.aborted} aborted."
    )


def _differences(results: Results, stated: str) -> list[str]:
    reference = results.conditions[0].name
    if not results.comparisons:
        return ["## Differences", "", f"{reference!r} is the only condition, so there is nothing to compare.", ""]
    text = COMPARED.format(margin=100 * results.margin, stated=f", {stated}" if stated else "")
    lines = [f"## Differences to {reference!r}", "", *margin_table(results.comparisons), "", text, ""]
    if len(results.participants) < LEAST_PARTICIPANTS:
        smallest = 2.0 ** (1 - len(results.participants))
        few = (
            f"**Too few participants for a test at 5 %**: the smallest p that {len(results.participants)} can give is"
            f" {smallest:.3g}."
        )
        lines += [few, ""]
    return [*lines, *other_table(results.comparisons), ""]


def _curve_section(results: Results) -> list[str]:
    if not results.comparisons:
        return []
    return ["## From which threshold on is performance worse?", "", _curve_text(results), ""]


def _curve_text(results: Results) -> str:
    shown = [each for each in results.comparisons if each.measure == "correct"]
    worse = [each for each in shown if each.adjusted < ALPHA and each.difference < 0.0]
    equal = [each for each in shown if each.equivalent]
    reference = results.conditions[0].name
    text = [
        f"Shown to be equivalent to {reference!r}: " + (", ".join(each.condition for each in equal) or "nothing") + ".",
        "Shown to be worse: " + (", ".join(each.condition for each in worse) or "nothing") + ".",
        "What is in neither list is undecided by these data.",
    ]
    text += [
        f"{each.condition}: the tests of equivalence alone would say so (p {_equals(each.within_margin)}), but the 90 %"
        " interval leaves the margin."
        for each in shown
        if each.within_margin is not None and each.within_margin < ALPHA and not each.equivalent
    ]
    text += [
        f"{each.condition}: the test finds it worse (p {_equals(each.adjusted)}), but the 95 % interval reaches 0."
        for each in worse
        if each.interval[1] >= 0.0
    ]
    point = results.curve
    if point is None:
        text.append("A curve needs two thresholds of one codec, no compression, and two participants.")
    elif point.at is None:
        text.append(
            f"The mean of the participants, made to fall monotonically, stays within the margin of"
            f" {100 * results.margin:g} points up to the largest threshold; {100 * point.reached:.0f} % of resamples"
            " of participants leave it."
        )
    else:
        high = f"{point.high:.1f} JND" if math.isfinite(point.high) else "beyond the largest threshold"
        text.append(
            f"The mean of the participants, made to fall monotonically and joined by lines, leaves the margin of"
            f" {100 * results.margin:g} points at **{point.at:.1f} JND** (95 % interval over resampled participants:"
            f" {point.low:.1f} JND to {high})."
        )
    return " ".join(text)


def _equals(probability: float) -> str:
    text = chance(probability)
    return text if text.startswith("<") else f"= {text}"


def _quality(results: Results) -> list[str]:
    if not results.predictors:
        return []
    lines = [
        "## Quality of experience",
        "",
        "How well objective measures of a block predict its rating, both about the mean of their participant:",
        "",
        "| measure | correlation | p | share of variance predicted |",
        "|---|---|---|---|",
    ]
    for each in results.predictors:
        predicted = f"{100 * each.predicted:.0f} %" if math.isfinite(each.predicted) else UNKNOWN
        lines.append(f"| {each.name} | {each.correlation:+.2f} | {chance(each.probability)} | {predicted} |")
    lines += ["", PREDICTED]
    if results.simulated:
        lines += ["", "**A simulated rating follows the step of the force by assumption; this table shows nothing.**"]
    return [*lines, ""]


def _models(effects: Sequence[Effect], note: str | None) -> list[str]:
    if not effects:
        return ["## Models", "", note, ""] if note else []
    lines = ["## Models", "", "| model | condition | log odds | 95 % interval | p |", "|---|---|---|---|---|"]
    for each in effects:
        known = math.isfinite(each.log_odds)
        against = f"{each.condition} − {each.reference}" if each.reference else each.condition
        estimate, low, high = (signed(value, 2) if known else UNKNOWN for value in (each.log_odds, each.low, each.high))
        odds = f"{estimate} | {low} to {high}" if known else f"{UNKNOWN} | {UNKNOWN}"
        lines.append(f"| {each.model} | {against} | {odds} | {chance(each.probability)} |")
    notes = dict.fromkeys(f"{each.model}: {each.note}." for each in effects)
    return [*lines, "", *[f"- {note}" for note in notes], ""]


def _laws(results: Results) -> list[str]:
    lines = ["## What 1 JND was", "", "| participant | Weber fraction | at least [N] | from |", "|---|---|---|---|"]
    lines += [
        f"| {each.participant} | {each.weber_fraction:.4g} | {each.floor_n:.4g} | {each.source} |"
        for each in results.laws
    ]
    fractions = [each.weber_fraction for each in results.laws]
    if fractions and min(fractions) < max(fractions):
        spread = f"Weber fractions from {min(fractions):.3g} to {max(fractions):.3g}"
        lines += ["", f"**1 JND is not the same for all**: {spread}, so a condition is not the same threshold for all."]
    return [*lines, ""] if fractions else []


def _jnds(people: Sequence[ParticipantFile]) -> list[str]:
    if not people:
        return []
    lines = [
        "## JND of each participant",
        "",
        JND_HEAD,
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for each in people:
        interval = UNKNOWN if each.low is None or each.high is None else f"{each.low:.3f} to {each.high:.3f}"
        alarms = f"{each.false_alarms} of {each.catch_pairs}" if each.catch_pairs else UNKNOWN
        lines.append(
            f"| {each.participant} | {each.method} | {each.weber_fraction:.3f} | {interval} |"
            f" {number(each.through_origin)} | {number(each.residual)} | {alarms} | {number(each.device_error_n)} |"
            f" {each.simulated or 'no'} |"
        )
    doubts = [f"- Participant {each.participant}, excluded: {why}." for each in people for why in each.excluded]
    doubts += [f"- Participant {each.participant}: {why}." for each in people for why in each.warnings]
    fractions = [each.weber_fraction for each in people if not each.excluded]
    error = standard_error(fractions)
    spread = "" if error is None else f" ± {error:.4f} (s.e.)"
    mean = f"Mean Weber fraction {fmean(fractions):.4f}{spread}" if fractions else "Every JND is excluded"
    left_out = f", without {len(people) - len(fractions)} excluded" if 0 < len(fractions) < len(people) else ""
    return [*lines, "", *doubts, *([""] if doubts else []), f"{mean}{left_out}. {JND_NOTE}", ""]


def _plain(name: str) -> str:
    return name.rpartition("/")[2].rpartition(".")[0].replace("-", " ")
