"""The report of a study in Markdown."""

import math
from collections.abc import Iterable, Sequence
from statistics import fmean
from typing import Final, TypeAlias

from hapticnet.experiment.table import UNKNOWN
from hapticnet_experiment.analysis import MEASURES, Comparison, ConditionResult, Figure, Measure, Results
from hapticnet_experiment.statistics import ALPHA, standard_error
from hapticnet_experiment.weber import ParticipantFile

Cells: TypeAlias = list[Sequence[str]]  # the rows of a table, the head first
LEAST_PARTICIPANTS: Final = 6  # participants below which no sign-flip test can find a difference at 5 %

JND_HEAD: Final = (
    "participant", "method", "Weber fraction, mean of ratios", "95 % interval", "residual",
    "false alarms", "error of the device [N]", "simulated",
)  # fmt: skip

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

SHARES: Final = (
    "An interval of a share covers the share that participants like these would reach (Korn & Graubard 1998); the"
    " standard error (s.e.) is over participants, n − 1. The paper printed means and standard errors only. It made no"
    " test; every probability below is of this study."
)

BYTES: Final = (
    "Bytes and packets per penetration count from the touch of a tissue to its breach, keepalives and UDP and IPv4"
    " headers included, as in `hapticnet demo`; traffic while nothing is touched, such as while the participant"
    " thinks, does not count. The saving grows with the rate of the samples and falls with the speed of the hand. The"
    " paper states neither, so its saving is a comparison, not a target; docs/benchmarks/tables.md has the saving over"
    " the rate, with the motion of the demo."
)

SIMULATED: Final = (
    "**No person took part.** A program answered instead of each participant; extras/experiment/observers.md says"
    " what such answers can show and what they cannot."
)


def markdown(
    results: Results | None,
    *,
    title: str,
    figures: Sequence[str] = (),
    people: Sequence[ParticipantFile] = (),
    origin: Sequence[str] = (),
    stated: str = "",
) -> str:
    """Return the report.

    `results` is None while only JNDs were measured (`people`). `figures` are names of pictures beside the report,
    `origin` lines on version, date and machine; `stated` says where the margin was stated: "stated in plan.toml".
    """
    simulated = {each.simulated for each in people if each.simulated} if results is None else results.simulated
    told = f" – SIMULATED ({', '.join(sorted(simulated))})" if simulated else ""
    blocks = [f"# {title}{told}", *([SIMULATED] if simulated else [])]
    if results is None:
        blocks.append("No trial of the ordering task was answered yet; these are the measured JNDs.")
    else:
        blocks += [
            _summary(results),
            _listed(results.missing),
            "## Conditions",
            _markdown_table(condition_table(results)),
            SHARES,
            BYTES,
            "Correct orders of each participant:",
            _markdown_table(_people_table(results)),
            *[f"![{name.removesuffix('.png').replace('-', ' ')}]({name})" for name in figures if name.endswith(".png")],
            *_differences(results, stated),
            *_verdicts(results),
            *_laws(results),
        ]
    blocks += [*_jnds(people), "## Origin", _listed(origin)]
    return "\n\n".join(filter(None, blocks)) + "\n"


def condition_table(results: Results) -> Cells:
    """Return the figures of each condition, the first row being the head."""
    conditions = results.conditions
    cells: Cells = [
        ["", *[each.name for each in conditions]],
        ["answered trials", *[str(each.trials) for each in conditions]],
        ["correct orders, 95 % over participants", *[_share(each.share, each.interval) for each in conditions]],
        ["the paper's, ± s.e.", *[_paper(each) for each in conditions]],
    ]
    for key, measure in MEASURES.items():
        shown = [each.figures[key] for each in conditions]
        if any(figure.mean is not None for figure in shown):
            cells.append([f"{measure.name}, mean ± s.e.", *[_figure(measure, figure) for figure in shown]])
    reference = conditions[0].figures["bytes"].mean
    if reference:
        spent = [each.figures["bytes"].mean for each in conditions]
        cells.append(["bytes saved", *[_percent(None if each is None else 1 - each / reference) for each in spent]])
        cells.append(["bytes saved in the paper", *[_percent(each.paper_byte_reduction) for each in conditions]])
    for number, name in enumerate(("softest–middle", "middle–hardest", "softest–hardest")):
        shares = [_share(each.pair_shares[number], each.pair_intervals[number]) for each in conditions]
        cells.append([f"correct pairs, {name}, 95 %", *shares])
    return cells


def _people_table(results: Results) -> Cells:
    cells: Cells = [["participant", *[condition.name for condition in results.conditions]]]
    for number, person in enumerate(results.participants):
        shares = [condition.figures["correct"].each[number] for condition in results.conditions]
        cells.append([person, *[UNKNOWN if math.isnan(share) else f"{100 * share:.0f} %" for share in shares]])
    return cells


def _differences(results: Results, stated: str) -> list[str]:
    reference = results.conditions[0].name
    if not results.comparisons:
        return ["## Differences", f"{reference!r} is the only condition, so there is nothing to compare."]
    measured = "measure", "comparison"
    tested = "95 % interval", "p", "p (Holm)"
    with_margin: Cells = [[*measured, "difference [points]", *tested, "equivalence p", "90 % interval"]]
    others: Cells = [[*measured, "difference", *tested]]
    for each in results.comparisons:
        if each.within_margin is None or each.interval_90 is None:
            others.append(_compared(each, 2))
        else:
            further = chance(each.within_margin), _between(each.interval_90, 100.0, 1)
            with_margin.append([*_compared(each, 1, points=""), *further])
    text = COMPARED.format(margin=100 * results.margin, stated=f", {stated}" if stated else "")
    blocks = [f"## Differences to {reference!r}", _markdown_table(with_margin), text]
    people = len(results.participants)
    if people < LEAST_PARTICIPANTS:
        blocks.append(
            f"**Too few participants for a test at 5 %**: the smallest p that {people} can give is"
            f" {2.0 ** (1 - people):.3g}."
        )
    return [*blocks, _markdown_table(others)]


def _compared(each: Comparison, digits: int, points: str = " [points]") -> list[str]:
    measure = MEASURES[each.measure]
    name, factor = measure.name, 1.0
    if measure.form.endswith("%"):
        name, factor, digits = name + points, 100.0, 1
    interval = _between(each.interval, factor, digits)
    difference = signed(factor * each.difference, digits)
    against = f"{each.condition} − {each.reference}"
    return [name, against, difference, interval, chance(each.probability), chance(each.adjusted)]


def _verdicts(results: Results) -> list[str]:
    if not results.comparisons:
        return []
    shown = [each for each in results.comparisons if each.measure == "correct"]
    worse = [each for each in shown if each.adjusted < ALPHA and each.difference < 0.0]
    equal = [each for each in shown if each.equivalent]
    reference = results.conditions[0].name
    text = [
        f"Shown to be equivalent to {reference!r}: " + (", ".join(each.condition for each in equal) or "nothing") + ".",
        "Shown to be worse: " + (", ".join(each.condition for each in worse) or "nothing") + ".",
        "These data do not decide about the others.",
    ]
    return ["## From which threshold on is performance worse?", " ".join(text)]


def _laws(results: Results) -> list[str]:
    cells: Cells = [["participant", "Weber fraction", "at least [N]", "from"]]
    cells += [
        [each.participant, f"{each.weber_fraction:.4g}", f"{each.floor_n:.4g}", each.source] for each in results.laws
    ]
    fractions = [each.weber_fraction for each in results.laws]
    if not fractions:
        return []
    blocks = ["## What 1 JND was", _markdown_table(cells)]
    if min(fractions) < max(fractions):
        spread = f"Weber fractions from {min(fractions):.3g} to {max(fractions):.3g}"
        blocks.append(f"**1 JND differs between participants**: {spread}, so a condition has different thresholds.")
    return blocks


def _jnds(people: Sequence[ParticipantFile]) -> list[str]:
    if not people:
        return []
    cells: Cells = [JND_HEAD]
    for each in people:
        interval = UNKNOWN if each.low is None or each.high is None else f"{each.low:.3f} to {each.high:.3f}"
        alarms = f"{each.false_alarms} of {each.catch_pairs}" if each.catch_pairs else UNKNOWN
        measured = each.residual, each.device_error_n
        residual, error_n = (UNKNOWN if value is None else f"{value:.3f}" for value in measured)
        cells.append(
            [each.participant, each.method, f"{each.weber_fraction:.3f}", interval, residual, alarms, error_n,
             each.simulated or "no"]
        )  # fmt: skip
    doubts = [f"Participant {each.participant}, excluded: {why}." for each in people for why in each.excluded]
    doubts += [f"Participant {each.participant}: {why}." for each in people for why in each.warnings]
    fractions = [each.weber_fraction for each in people if not each.excluded]
    error = standard_error(fractions)
    spread = "" if error is None else f" ± {error:.4f} (s.e.)"
    mean = f"Mean Weber fraction {fmean(fractions):.4f}{spread}" if fractions else "Every JND is excluded"
    left_out = f", without {len(people) - len(fractions)} excluded" if 0 < len(fractions) < len(people) else ""
    return ["## JND of each participant", _markdown_table(cells), _listed(doubts), f"{mean}{left_out}. {JND_NOTE}"]


def _summary(results: Results) -> str:
    people = f"{len(results.participants)} participant{'s' if len(results.participants) > 1 else ''}"
    trials = sum(each.trials for each in results.conditions)
    return (
        f"{people}, {trials} answered trials in {len(results.conditions)} conditions; {results.repeated} trials were"
        f" repeated because the device did not deliver, {results.aborted} aborted."
    )


def _markdown_table(cells: Cells) -> str:
    head, *lines = (f"| {' | '.join(line)} |" for line in cells)
    return "\n".join([head, "|---" * len(cells[0]) + "|", *lines])


def _listed(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _figure(measure: Measure, figure: Figure) -> str:
    if figure.mean is None:
        return UNKNOWN
    text = measure.form.format(measure.factor * figure.mean)
    if figure.error is None:
        return text
    number, _, unit = text.partition(" ")
    return f"{number} ± {measure.form.format(measure.factor * figure.error).partition(' ')[0]} {unit}".rstrip()


def _share(share: float, interval: tuple[float, float]) -> str:
    low, high = interval
    return UNKNOWN if math.isnan(share) else f"{100 * share:.1f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _percent(share: float | None) -> str:
    return UNKNOWN if share is None else f"{100 * share:.1f} %"


def _paper(condition: ConditionResult) -> str:
    if condition.paper_correct is None:
        return UNKNOWN
    error = f" ± {100 * condition.paper_error:.1f}" if condition.paper_error is not None else ""
    return f"{100 * condition.paper_correct:.1f}{error} %"


def _between(interval: tuple[float, float], factor: float, digits: int) -> str:
    low, high = (factor * end for end in interval)
    return f"{signed(low, digits)} to {signed(high, digits)}" if math.isfinite(low + high) else UNKNOWN


def signed(value: float, digits: int) -> str:
    """Return a number with its sign, and without one if it rounds to zero."""
    rounded = round(value, digits)
    return f"{rounded:+.{digits}f}" if rounded else f"{0:.{digits}f}"


def chance(probability: float) -> str:
    """Return a probability as text."""
    return "< 0.001" if probability < 0.001 else f"{probability:.3f}"
