"""The tables of a study's results: Markdown, CSV and LaTeX."""

import csv
import io
import math
from collections.abc import Sequence
from typing import Final

from hapticnet.experiment.latex import PACKAGES, escaped, row, table
from hapticnet.study.measures import NAMES
from hapticnet.study.results import Comparison, ConditionResult, Figure, Results

UNKNOWN: Final = "–"

FORMS: Final[dict[str, tuple[float, str]]] = {
    "correct": (100.0, "{:.1f} %"),
    "pairs": (100.0, "{:.1f} %"),
    "kendall": (1.0, "{:.2f}"),
    "bytes": (1.0, "{:,.0f}"),
    "packets": (1.0, "{:,.1f}"),
    "time_s": (1.0, "{:.1f}"),
    "insertions": (1.0, "{:.1f}"),
    "penetrations": (1.0, "{:.1f}"),
    "peak_n": (1.0, "{:.2f}"),
    "delivered": (100.0, "{:.0f} %"),
    "error": (1.0, "{:.3f}"),
    "speed_m_per_s": (1000.0, "{:.0f} mm/s"),
    "rating": (1.0, "{:.2f}"),
}


def condition_table(results: Results) -> list[str]:
    """Return the figures of each condition as lines of Markdown."""
    head = [condition.name for condition in results.conditions]
    lines = [
        "| | " + " | ".join(head) + " |",
        "|---" * (len(head) + 1) + "|",
        _line("answered trials", [str(each.trials) for each in results.conditions]),
        _line(
            "correct orders, 95 % over participants", [_share(each.share, each.interval) for each in results.conditions]
        ),
        _line("the paper's, ± s.e.", [_paper(each) for each in results.conditions]),
    ]
    for key, name in NAMES.items():
        shown = [each.figures[key] for each in results.conditions]
        if any(figure.mean is not None for figure in shown):
            lines.append(_line(f"{name}, mean ± s.e.", [_cell(key, figure) for figure in shown]))
    reference = results.conditions[0].figures["bytes"].mean
    if reference:
        saved = [
            UNKNOWN
            if each.figures["bytes"].mean is None
            else f"{100 * (1 - each.figures['bytes'].mean / reference):.1f} %"
            for each in results.conditions
        ]
        lines.append(_line("bytes saved", saved))
        lines.append(
            _line(
                "bytes saved in the paper",
                [
                    UNKNOWN if each.paper_byte_reduction is None else f"{100 * each.paper_byte_reduction:.1f} %"
                    for each in results.conditions
                ],
            )
        )
    for number, name in enumerate(("softest–middle", "middle–hardest", "softest–hardest")):
        shares = [_share(each.pair_shares[number], each.pair_intervals[number]) for each in results.conditions]
        lines.append(_line(f"correct pairs, {name}, 95 %", shares))
    return lines


def people_table(results: Results) -> list[str]:
    """Return the correct orders of each participant as lines of Markdown."""
    head = [condition.name for condition in results.conditions]
    lines = ["| participant | " + " | ".join(head) + " |", "|---" * (len(head) + 1) + "|"]
    for number, person in enumerate(results.participants):
        shares = [condition.figures["correct"].each[number] for condition in results.conditions]
        lines.append(_line(person, [UNKNOWN if math.isnan(share) else f"{100 * share:.0f} %" for share in shares]))
    return lines


def margin_table(comparisons: Sequence[Comparison]) -> list[str]:
    """Return the comparisons of measures with a margin of equivalence as lines of Markdown."""
    lines = [
        "| measure | comparison | difference [points] | 95 % interval | p | p (Holm) | equivalence p | 90 % interval |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for each in comparisons:
        if each.within_margin is not None and each.interval_90 is not None:
            lines.append(
                f"| {NAMES[each.measure]} | {each.condition} − {each.reference} | {signed(100 * each.difference, 1)} |"
                f" {_points(each.interval)} | {chance(each.probability)} | {chance(each.adjusted)} |"
                f" {chance(each.within_margin)} | {_points(each.interval_90)} |"
            )
    return lines


def other_table(comparisons: Sequence[Comparison]) -> list[str]:
    """Return the comparisons of the other measures as lines of Markdown."""
    lines = ["| measure | comparison | difference | 95 % interval | p | p (Holm) |", "|---|---|---|---|---|---|"]
    for each in comparisons:
        if each.within_margin is not None:
            continue
        name, factor, digits = NAMES[each.measure], 1.0, 2
        if FORMS[each.measure][1].endswith("%"):
            name, factor, digits = f"{name} [points]", 100.0, 1
        low, high = (factor * end for end in each.interval)
        interval = f"{signed(low, digits)} to {signed(high, digits)}" if math.isfinite(low + high) else UNKNOWN
        lines.append(
            f"| {name} | {each.condition} − {each.reference} | {signed(factor * each.difference, digits)} |"
            f" {interval} | {chance(each.probability)} | {chance(each.adjusted)} |"
        )
    return lines


def csv_text(results: Results, origin: Sequence[str] = ()) -> str:
    """Return every figure of every condition and participant as CSV, with the origin as comments."""
    buffer = io.StringIO()
    buffer.writelines(f"# {line}\n" for line in (*_warning(results), *origin))
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["condition", "codec", "multiplier", "measure", "participant", "value"])
    for condition in results.conditions:
        for key, figure in condition.figures.items():
            for person, value in (
                ("mean", figure.mean),
                ("standard error", figure.error),
                *zip(results.participants, figure.each, strict=True),
            ):
                known = value is not None and math.isfinite(value)
                writer.writerow(
                    [
                        condition.name,
                        condition.codec,
                        condition.multiplier,
                        key,
                        person,
                        f"{value:.9g}" if known else "n/a",
                    ]
                )
    return buffer.getvalue()


def latex(results: Results, origin: Sequence[str] = ()) -> str:
    """Return the table of the conditions for a paper, with booktabs, no wider than the page."""
    cells = [row(["", *[each.name for each in results.conditions]]), "\\midrule"]
    cells += [row([cell.strip() for cell in line.strip("|").split("|")]) for line in condition_table(results)[2:]]
    caption = [f"% caption: {escaped(line)}" for line in _warning(results)]
    comments = [f"% {line}" for line in (*_warning(results), *origin)]
    return "\n".join([*comments, PACKAGES, *table("l" + "r" * len(results.conditions), cells), *caption]) + "\n"


def _warning(results: Results) -> list[str]:
    return (
        [f"SIMULATED: answers of the observer {', '.join(results.simulated)}; no person took part"]
        if results.simulated
        else []
    )


def _line(name: str, cells: Sequence[str]) -> str:
    return f"| {name} | " + " | ".join(cells) + " |"


def _cell(key: str, figure: Figure) -> str:
    if figure.mean is None:
        return UNKNOWN
    factor, form = FORMS[key]
    text = form.format(factor * figure.mean)
    if figure.error is None:
        return text
    number, _, unit = text.partition(" ")
    error = form.format(factor * figure.error).partition(" ")[0]
    return f"{number} ± {error} {unit}".rstrip()


def _share(share: float, interval: tuple[float, float]) -> str:
    low, high = interval
    return UNKNOWN if math.isnan(share) else f"{100 * share:.1f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _paper(condition: ConditionResult) -> str:
    if condition.paper_correct is None:
        return UNKNOWN
    error = f" ± {100 * condition.paper_error:.1f}" if condition.paper_error is not None else ""
    return f"{100 * condition.paper_correct:.1f}{error} %"


def _points(interval: tuple[float, float]) -> str:
    if not all(map(math.isfinite, interval)):
        return UNKNOWN
    return f"{signed(100 * interval[0], 1)} to {signed(100 * interval[1], 1)}"


def signed(value: float, digits: int) -> str:
    """Return a number with its sign, and without one if it rounds to zero."""
    rounded = round(value, digits)
    return f"{rounded:+.{digits}f}" if rounded else f"{0:.{digits}f}"


def chance(probability: float) -> str:
    """Return a probability as text."""
    return "< 0.001" if probability < 0.001 else f"{probability:.3f}"


def number(value: float | None) -> str:
    """Return a number as text."""
    return UNKNOWN if value is None else f"{value:.3f}"
