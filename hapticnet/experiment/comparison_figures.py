"""Pictures of a comparison: packet and byte rate over every measure of error with the optimum drawn in, and time."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from hapticnet.codec.registry import CODECS
from hapticnet.experiment.comparison import Row
from hapticnet.experiment.figures import INK, pyplot

Points = list[tuple[float, float]]
Figure = Callable[[Row], float | None]

COLUMNS: Final = 5
LONG: Final = 26
"""Letters of a codec with its parameters that leave no room for another beside it in a legend."""

MEASURES: Final[tuple[tuple[str, str, bool, Figure], ...]] = (
    ("RMSE [N]", "log", True, lambda row: row.quality.rmse_n),
    ("largest error [N]", "log", True, lambda row: row.quality.max_error_n),
    ("share of samples beyond 1 JND", "linear", True, lambda row: row.quality.exceed_jnd_fraction),
    ("perceptual MSE [JND²]", "log", True, lambda row: row.quality.perceptual_mse),
    ("PSNR [dB]", "linear", True, lambda row: row.quality.psnr_db),
    ("HPW-PSNR [dB]", "linear", True, lambda row: row.quality.hpw_psnr_db),
    ("mean jump at an update [JND]", "linear", False, lambda row: row.quality.send_jump_mean_jnd),
    ("mean age of the stimulus [ms]", "linear", False, lambda row: row.quality.age_mean_us / 1e3),
    ("most packets in 100 ms", "log", False, lambda row: float(row.quality.worst_100ms_packets)),
    ("energy created, at most [mJ]", "linear", False, lambda row: _milli(row.quality.energy_peak_j)),
)
"""Of every measure: label, scale, whether the fewest packets that the law allows have one, and the value.

docs/perception.md has the formulae.
"""

DASHES: Final = ("-", "--", ":", "-.")
MARKERS: Final = ("o", "s", "^", "D")
"""For variants of one codec, which share a colour."""


def draw_comparison(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw three pictures for each recording, a point for each threshold, and return their files.

    Raises
    ------
    UnavailableError
        When matplotlib is missing.
    """
    files = []
    for number, (trial, block) in enumerate(groupby(rows, key=lambda row: row.trial), start=1):
        own = [row for row in block if row.codec != "raw"]
        if own:
            stem = "".join(character if character.isalnum() else "-" for character in trial)
            for name, label, rate in (
                ("packets", "packets/s", lambda row: row.packets_per_s),
                ("bytes", "kB/s, headers included", lambda row: row.wire_bytes_per_s / 1e3),
            ):
                file = folder / f"{number}-{stem}-{name}.png"
                thresholds = ", ".join(f"{each:g}" for each in dict.fromkeys(row.multiplier for row in own))
                title = f"{trial}: {label} over each measure of error, a point for each threshold ({thresholds} JND)"
                files.append(_draw_rates(own, title, label, rate, file))
            files.append(_draw_cost(own, f"{trial}: time over error", folder / f"{number}-{stem}-cost.png"))
    return files


def draw_codecs(axes: Any, points: Mapping[str, Points], *, highlight: str | None = None) -> None:
    """Draw a line for each codec on logarithmic axes upward; a codec has the same colour in every picture."""
    variants: Counter[int] = Counter()
    for label, line in points.items():
        index = list(CODECS).index(label.partition(":")[0])
        strong = label == highlight
        variant = variants[index] % len(DASHES)
        variants[index] += 1
        axes.plot(
            *zip(*line, strict=True),
            MARKERS[variant] + DASHES[variant],
            color=f"C{index % 10}",
            markerfacecolor=f"C{index % 10}" if index < 10 else "white",
            markersize=6 if strong else 4,
            linewidth=2.2 if strong else 1.0,
            zorder=3 if strong else 2,
            label=label,
        )


def finish_axes(axes: Any, *, across: str = "linear") -> None:
    """Give axes their scales, plain numbers and a grid."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for scale, axis, set_scale, which in (
        ("log", axes.yaxis, axes.set_yscale, 1),
        (across, axes.xaxis, axes.set_xscale, 0),
    ):
        # What is all zero, as the error of a force that stands still, has no place on a logarithmic scale.
        if scale == "log" and any(value > 0.0 for line in axes.get_lines() for value in line.get_data()[which]):
            set_scale("log")
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
    axes.grid(linewidth=0.4, alpha=0.5, which="both")
    axes.spines[["top", "right"]].set_visible(False)


def _draw_rates(rows: list[Row], title: str, label: str, rate: Callable[[Row], float], file: Path) -> Path:
    plt = pyplot()
    shown = [measure for measure in MEASURES if any(_known(measure[3](row)) for row in rows)]
    height = math.ceil(len(shown) / COLUMNS)
    figure, grid = plt.subplots(
        height, COLUMNS, figsize=(3.4 * COLUMNS, 3.4 * height + 0.9), layout="constrained", sharey=True, squeeze=False
    )
    for axes in grid.flat[len(shown) :]:
        axes.remove()
    # The fewest packets have no error of their own but that the law holds; they are drawn at the deadband's.
    plain = [row for row in rows if row.codec == "deadband" and row.cost.sent and label == "packets/s"]
    plain = [row for row in plain if row.label == plain[0].label]
    for axes, (heading, scale, bounded, measure) in zip(grid.flat, shown, strict=False):
        draw_codecs(axes, _points(rows, measure, rate))
        for name, style, marker, fewest in (
            ("fewest, hold", "--", "_", [row.limits.holds for row in plain]),
            ("fewest, lines", ":", "1", [row.limits.lines for row in plain]),
        ):
            line = [
                (value, rate(row) * count / row.cost.sent)
                for row, count in zip(plain, fewest, strict=True)
                if bounded and _known(value := measure(row))
            ]
            if line:
                described = f"{name} (at the deadband's error)"
                axes.plot(*zip(*line, strict=True), style, marker=marker, color=INK, markersize=9, label=described)
        finish_axes(axes, across=scale)
        axes.set_xlabel(heading)
    for row_of_axes in grid:
        row_of_axes[0].set_ylabel(label)
    figure.legend(
        *grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9, frameon=False
    )
    return _save(plt, figure, title, file)


def _draw_cost(rows: list[Row], title: str, file: Path) -> Path:
    plt = pyplot()
    figure, axes = plt.subplots(figsize=(6.8, 5.0), layout="constrained")
    draw_codecs(axes, _points(rows, lambda row: row.quality.rmse_n, lambda row: row.nanoseconds_per_sample / 1e3))
    finish_axes(axes, across="log")
    axes.set_xlabel("RMSE [N]")
    axes.set_ylabel("encoding and decoding, plain Python [µs/sample]")
    longest = max(len(row.label) for row in rows)
    figure.legend(loc="outside lower center", ncols=3 if longest < LONG else 1, fontsize=8, frameon=False)
    return _save(plt, figure, title, file)


def _points(rows: list[Row], across: Figure, up: Callable[[Row], float]) -> dict[str, Points]:
    """Return the points of each codec in the order of its thresholds, those without a value left out."""
    points: dict[str, Points] = {}
    for row in sorted(rows, key=lambda row: row.multiplier):
        value = across(row)
        if value is not None and math.isfinite(value):
            points.setdefault(row.label, []).append((value, up(row)))
    return {label: points[label] for label in dict.fromkeys(row.label for row in rows) if label in points}


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _milli(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _save(plt: Any, figure: Any, title: str, file: Path) -> Path:
    figure.suptitle(title, fontsize=11)
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return file
