"""Figures of a study: bytes per penetration (the paper's Fig. 4) and correct orders (Fig. 5)."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, Final

from hapticnet.experiment.style import GREY, INK, SKY, VERMILION, picture
from hapticnet_experiment.analysis import CHANCE, Results

HEIGHT_IN: Final = 3.6
FORMS: Final = ("pdf", "png")
TITLE_WIDTH: Final = 80  # characters in a line of a title
PAPER: Final = "the paper"
ASIDE: Final = 0.22  # distance of the participants' points from the middle of a bar, which is 0.55 wide


def draw_results(results: Results, folder: Path) -> list[Path]:
    """Draw every figure of the results as PDF and PNG; return the files."""
    paints: dict[str, Callable[[Any, Results], None]] = {"bytes-per-penetration": _bytes, "correct-orders": _correct}
    files = [folder / f"{name}.{form}" for name in paints for form in FORMS]
    for file in files:
        with picture(file, HEIGHT_IN) as figure:
            paints[file.stem](figure.subplots(), results)
    return files


def mark_level(axes: Any, value: float, name: str) -> None:
    """Draw a dotted line at a value, such as chance, with its name at the right of the axes."""
    axes.axhline(value, color=INK, linestyle=":", linewidth=0.8)
    axes.annotate(
        name, (1.0, value), xycoords=("axes fraction", "data"), xytext=(3, 0), textcoords="offset points",
        va="center", annotation_clip=False,
    )  # fmt: skip


def _title(axes: Any, text: str, results: Results, *below: str, **look: Any) -> None:
    """Set the title of a figure, with separate lines if the data are simulated."""
    told = wrap(f"SIMULATED ({', '.join(results.simulated)})", TITLE_WIDTH) if results.simulated else []
    axes.set_title("\n".join([text, *told, *below]), **look)


def _people(axes: Any, place: float, values: Sequence[float], factor: float, span: float, *, aside: float) -> None:
    """Draw each participant as a point beside `place`; those within 2 % of the axis' span are side by side."""
    known = [value * factor for value in values if math.isfinite(value)]
    rows = Counter(round(value / (0.02 * span)) for value in known)
    drawn: Counter[int] = Counter()
    for value in sorted(known):
        row = round(value / (0.02 * span))
        offset = min(0.035, 0.3 / rows[row]) * (drawn[row] - (rows[row] - 1) / 2.0)
        axes.plot(place + aside + offset, value, "o", color=INK, markersize=2.6, alpha=0.7, zorder=4)
        drawn[row] += 1


def _ticks(axes: Any, results: Results) -> None:
    axes.set_xticks(range(len(results.conditions)), [each.name for each in results.conditions])
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("condition")


def _bytes(axes: Any, results: Results) -> None:
    first = results.conditions[0].figures["bytes"].mean
    span = max([0.0, *[each.figures["bytes"].mean or 0.0 for each in results.conditions]])
    for place, condition in enumerate(results.conditions):
        figure = condition.figures["bytes"]
        if figure.mean is None:
            continue
        axes.bar(place, figure.mean, width=0.55, color=SKY if place else GREY, zorder=2)
        axes.errorbar(place, figure.mean, yerr=figure.error, color=INK, capsize=4, linewidth=1.0, zorder=3)
        _people(axes, place, figure.each, 1.0, span, aside=ASIDE)
        text = f"{figure.mean:,.0f} B" + (f"\n{_saved(1.0 - figure.mean / first)}" if place and first else "")
        top = max([figure.mean + (figure.error or 0.0), *[each for each in figure.each if math.isfinite(each)]])
        axes.annotate(text, (place, top), xytext=(0, 3), textcoords="offset points", ha="center", va="bottom")
        if condition.paper_byte_reduction and first:
            paper = (1.0 - condition.paper_byte_reduction) * first
            axes.plot([place - 0.32, place + 0.32], [paper, paper], color=VERMILION, linestyle="--", zorder=5)
            told = f"{PAPER}'s saving, {_saved(condition.paper_byte_reduction)},\nof the bytes measured here"
            axes.annotate(told, (place + 0.35, paper), color=VERMILION, va="center")
    _ticks(axes, results)
    axes.margins(y=0.2)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_formatter("{x:,.0f}")
    axes.set_ylabel("bytes per penetration, with headers")
    _title(axes, "Bytes per penetration: mean, s.e., each participant", results)


def _saved(share: float) -> str:
    return f"{-100 * share:+.1f} %".replace("-", "−")


def _correct(axes: Any, results: Results) -> None:
    for place, condition in enumerate(results.conditions):
        figure, (low, high) = condition.figures["correct"], condition.interval
        axes.bar(place, 100 * condition.share, width=0.55, color=SKY if place else GREY, zorder=2)
        axes.plot([place, place], [100 * low, 100 * high], color=INK, linewidth=0.8, zorder=3)
        if figure.error is not None and figure.mean is not None:
            error = 100 * figure.error
            axes.errorbar(place, 100 * figure.mean, yerr=error, color=INK, capsize=4, linewidth=2.2, zorder=3)
        _people(axes, place, figure.each, 100.0, 100.0, aside=ASIDE)
        if condition.paper_correct is not None:
            paper_error = 100 * (condition.paper_error or 0.0)
            axes.errorbar(
                place - 0.2, 100 * condition.paper_correct, yerr=paper_error, fmt="D", color=VERMILION, capsize=3,
                markersize=4, zorder=5, label=None if place else f"{PAPER}, s.e.",
            )  # fmt: skip
    mark_level(axes, 100 * CHANCE, "chance")
    _ticks(axes, results)
    axes.set_ylim(0.0, 104.0)
    axes.set_ylabel("correct orders [%]")
    told = "bars: mean; thick: s.e.; thin: 95 % over participants; dots: participants; diamonds: the paper, s.e."
    _title(axes, "Correct orders", results, told, fontsize=8)
