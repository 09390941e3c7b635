"""Figures of a study: bytes per penetration, correct orders, the curve of thresholds, pairs, ratings, and power."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.experiment.style import BLUE, COLOURS, DASHES, GREEN, INK, MARKERS, ORANGE, SKY, VERMILION, picture
from hapticnet.study.power import Power
from hapticnet.study.results import CHANCE, ConditionResult, Results
from hapticnet.study.statistics import falling

HEIGHT_IN: Final = 3.6
GREY: Final = "#9aa5b1"
FORMS: Final = ("pdf", "png")
PAPER: Final = "the paper"


def draw_results(results: Results, folder: Path) -> list[Path]:
    """Draw every figure of the results as PDF and PNG; return the files.

    Raises
    ------
    UnavailableError
        If matplotlib is missing.
    """
    drawn = [
        _draw(folder, "bytes-per-penetration", lambda axes: _bytes(axes, results)),
        _draw(folder, "correct-orders", lambda axes: _correct(axes, results)),
        _draw(folder, "pairs", lambda axes: _pairs(axes, results)),
    ]
    if results.curve is not None:
        drawn.append(_draw(folder, "curve", lambda axes: _curve(axes, results)))
    if any(each.figures["rating"].mean is not None for each in results.conditions):
        drawn.append(_draw(folder, "ratings", lambda axes: _ratings(axes, results)))
    return [file for files in drawn for file in files]


def draw_power(powers: Sequence[Power], source: str, folder: Path) -> list[Path]:
    """Draw the power of each condition against the number of participants as PDF and PNG; return the files."""
    return _draw(folder, "power", lambda axes: _power(axes, powers, source))


def titled(text: str, simulated: Sequence[str]) -> str:
    """Return a title that says so if the data are simulated."""
    return f"{text} – SIMULATED ({', '.join(simulated)})" if simulated else text


def _draw(folder: Path, name: str, paint: Callable[[Any], None]) -> list[Path]:
    files = [folder / f"{name}.{form}" for form in FORMS]
    for file in files:
        with picture(file, HEIGHT_IN) as figure:
            paint(figure.subplots())
    return files


def _people(axes: Any, place: float, values: Sequence[float], factor: float = 1.0) -> None:
    """Draw each participant as a point; equal ones stand beside each other."""
    known = sorted(value * factor for value in values if math.isfinite(value))
    span = max(known, default=1.0) - min(known, default=0.0) or 1.0
    for index, value in enumerate(known):
        twins = [other for other in known if abs(other - value) < 0.01 * span]
        offset = 0.035 * ((index - known.index(twins[0])) - (len(twins) - 1) / 2.0)
        axes.plot(place + 0.22 + offset, value, "o", color=INK, markersize=2.6, alpha=0.7, zorder=4)


def _ticks(axes: Any, results: Results) -> None:
    axes.set_xticks(range(len(results.conditions)), [each.name for each in results.conditions])
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("condition")


def _bytes(axes: Any, results: Results) -> None:
    first = results.conditions[0].figures["bytes"].mean
    for place, condition in enumerate(results.conditions):
        figure = condition.figures["bytes"]
        if figure.mean is None:
            continue
        axes.bar(place, figure.mean, width=0.55, color=SKY if place else GREY, zorder=2)
        axes.errorbar(place, figure.mean, yerr=figure.error, color=INK, capsize=4, linewidth=1.0, zorder=3)
        _people(axes, place, figure.each)
        text = f"{figure.mean:,.0f} B" + (f"\n−{1.0 - figure.mean / first:.1%}" if place and first else "")
        top = max([figure.mean + (figure.error or 0.0), *[each for each in figure.each if math.isfinite(each)]])
        axes.annotate(text, (place, top), xytext=(0, 3), textcoords="offset points", ha="center", va="bottom")
        if condition.paper_byte_reduction and first:
            paper = (1.0 - condition.paper_byte_reduction) * first
            axes.plot([place - 0.32, place + 0.32], [paper, paper], color=VERMILION, linestyle="--", zorder=5)
            told = f"{PAPER}: −{condition.paper_byte_reduction:.1%}"
            axes.annotate(told, (place + 0.35, paper), color=VERMILION, va="center")
    _ticks(axes, results)
    axes.margins(y=0.2)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("bytes per penetration, headers included")
    axes.set_title(titled("Bytes per penetration: mean, s.e., each participant", results.simulated))


def _correct(axes: Any, results: Results) -> None:
    for place, condition in enumerate(results.conditions):
        figure, (low, high) = condition.figures["correct"], condition.interval
        axes.bar(place, 100 * condition.share, width=0.55, color=SKY if place else GREY, zorder=2)
        axes.plot([place, place], [100 * low, 100 * high], color=INK, linewidth=0.8, zorder=3)
        if figure.error is not None and figure.mean is not None:
            error = 100 * figure.error
            axes.errorbar(place, 100 * figure.mean, yerr=error, color=INK, capsize=4, linewidth=2.2, zorder=3)
        _people(axes, place, figure.each, 100.0)
        if condition.paper_correct is not None:
            paper_error = 100 * (condition.paper_error or 0.0)
            axes.errorbar(
                place - 0.2, 100 * condition.paper_correct, yerr=paper_error, fmt="D", color=VERMILION, capsize=3,
                markersize=4, zorder=5, label=None if place else f"{PAPER}, s.e.",
            )  # fmt: skip
    axes.axhline(100 * CHANCE, color=INK, linestyle=":", linewidth=0.8)
    axes.annotate("chance", (-0.45, 100 * CHANCE), xytext=(0, 2), textcoords="offset points", fontsize=7)
    _ticks(axes, results)
    axes.set_ylim(0.0, 104.0)
    axes.set_ylabel("correct orders [%]")
    told = "bars: mean; thick: s.e.; thin: Wilson 95 %; dots: participants; diamonds: the paper, s.e."
    axes.set_title(titled("Correct orders", results.simulated) + f"\n{told}", fontsize=8)


def _pairs(axes: Any, results: Results) -> None:
    names = ("softest–middle", "middle–hardest", "softest–hardest")
    for number, name in enumerate(names):
        shares = [100 * each.pair_shares[number] for each in results.conditions]
        look = {"color": COLOURS[number], "marker": MARKERS[number], "linestyle": DASHES[number]}
        axes.plot(range(len(shares)), shares, **look, label=name)
    axes.axhline(50.0, color=INK, linestyle=":", linewidth=0.8)
    _ticks(axes, results)
    axes.set_ylim(40.0, 103.0)
    axes.set_ylabel("correct pairs [%]")
    axes.legend(loc="lower left")
    axes.set_title(titled("Which pairs are told apart", results.simulated))


def _curve(axes: Any, results: Results) -> None:
    along: list[ConditionResult] = [each for each in results.conditions if each.figures["correct"].mean is not None]
    x = [each.multiplier for each in along]
    reference = np.array(along[0].figures["correct"].each)
    for condition in along:
        own = np.array(condition.figures["correct"].each) - reference
        axes.plot(np.full(len(own), condition.multiplier), 100 * own, "o", color=GREY, markersize=2.6)
    means = [100 * float(np.nanmean(np.array(each.figures["correct"].each) - reference)) for each in along]
    axes.plot(x, means, color=BLUE, marker="o", label="mean difference to none")
    scores = np.array([each.figures["correct"].each for each in along])
    scores = scores[:, np.isfinite(scores).all(axis=0)].mean(axis=1)
    smooth = falling(scores)
    axes.plot(x, 100 * (smooth - smooth[0]), color=VERMILION, linewidth=0.9, label="made to fall monotonically")
    for comparison in results.comparisons:
        if comparison.measure == "correct" and all(map(math.isfinite, comparison.interval)):
            place = next(each.multiplier for each in along if each.name == comparison.condition)
            low, high = comparison.interval
            axes.plot([place, place], [100 * low, 100 * high], color=BLUE, linewidth=1.0)
    axes.axhspan(-100 * results.margin, 100 * results.margin, color=GREEN, alpha=0.15, linewidth=0, label="margin")
    point = results.curve
    if point is not None and point.at is not None:
        axes.axvline(point.at, color=VERMILION, linestyle="--", label=f"leaves the margin at {point.at:.1f} JND")
        axes.axvspan(point.low, min(point.high, max(x)), color=ORANGE, alpha=0.15, linewidth=0)
    axes.set_xlabel("threshold [JND]")
    axes.set_ylabel("correct orders less those\nwithout compression [%]")
    axes.legend(loc="lower left")
    axes.set_title(titled("From which threshold on is performance worse?", results.simulated))


def _ratings(axes: Any, results: Results) -> None:
    for place, condition in enumerate(results.conditions):
        figure = condition.figures["rating"]
        if figure.mean is not None:
            axes.errorbar(place, figure.mean, yerr=figure.error, fmt="o", color=BLUE, capsize=4)
            _people(axes, place, figure.each)
    _ticks(axes, results)
    axes.set_ylim(0.8, 7.2)
    axes.set_ylabel("rating, 1 (bad) to 7 (excellent)")
    axes.set_title(titled("Quality of experience: mean, s.e., each participant", results.simulated))


def _power(axes: Any, powers: Sequence[Power], source: str) -> None:
    lines = sorted({(each.condition, each.trials) for each in powers if each.difference or each.power})
    conditions = list(dict.fromkeys(each.condition for each in powers))
    trials = sorted({each.trials for each in powers})
    for condition, each_trials in lines:
        own = sorted(
            (each.participants, each.power)
            for each in powers
            if (each.condition, each.trials) == (condition, each_trials)
        )
        number = conditions.index(condition) - 1
        axes.plot(
            *zip(*own, strict=True), color=COLOURS[number % len(COLOURS)], marker=MARKERS[number % len(MARKERS)],
            linestyle=DASHES[trials.index(each_trials) % len(DASHES)], label=f"{condition}, {each_trials} trials",
        )  # fmt: skip
    axes.axhline(0.8, color=INK, linestyle=":", linewidth=0.8)
    axes.axhline(0.05, color=INK, linestyle=":", linewidth=0.8)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("participants")
    axes.set_ylabel("power of the sign-flip test at 5 %")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=6.5)
    axes.set_title(titled("Power to find a difference to no compression", [source]))
