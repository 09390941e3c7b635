"""Pictures of a comparison: packet and byte rate against error with the optimum drawn in, and time against error."""

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from hapticnet.experiment.comparison import Row
from hapticnet.experiment.figures import pyplot


def draw_comparison(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw two pictures for each recording and return their files.

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
            files.append(_draw_rates(own, trial, folder / f"{number}-{stem}-rate.png"))
            files.append(_draw_cost(own, trial, folder / f"{number}-{stem}-cost.png"))
    return files


def _draw_rates(rows: list[Row], title: str, file: Path) -> Path:
    plt = pyplot()
    figure, (packets, size) = plt.subplots(1, 2, figsize=(11.5, 5.0), layout="constrained")
    _draw_codecs(packets, rows, lambda row: row.quality.rmse_n, lambda row: row.packets_per_s)
    _draw_codecs(size, rows, lambda row: row.quality.rmse_n, lambda row: row.wire_bytes_per_s / 1000.0)
    # The fewest packets say nothing of an error but that the law holds; they are drawn at the first codec's.
    first = [row for row in rows if row.codec == rows[0].codec]
    counts = {
        "optimum, hold": ("--", [row.limits.holds for row in first]),
        "optimum, lines": (":", [row.limits.lines for row in first]),
    }
    for name, (style, fewest) in counts.items():
        points = sorted(
            (row.quality.rmse_n, row.packets_per_s * count / max(row.cost.sent, 1))
            for row, count in zip(first, fewest, strict=True)
        )
        packets.plot(*zip(*points, strict=True), marker="_", linestyle=style, color="#222222", markersize=9, label=name)
    packets.set_ylabel("packets/s")
    size.set_ylabel("kB/s, headers included")
    for axes in (packets, size):
        axes.set_xlabel("RMSE [N]")
    figure.legend(*packets.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return _finish(plt, figure, f"{title}: rate against error, a point for each threshold", file)


def _draw_cost(rows: list[Row], title: str, file: Path) -> Path:
    plt = pyplot()
    figure, axes = plt.subplots(figsize=(6.8, 5.0), layout="constrained")
    _draw_codecs(axes, rows, lambda row: row.quality.rmse_n, lambda row: row.nanoseconds_per_sample / 1000.0)
    axes.set_xlabel("RMSE [N]")
    axes.set_ylabel("encoding and decoding, plain Python [µs/sample]")
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return _finish(plt, figure, f"{title}: time against error", file)


def _draw_codecs(axes: Any, rows: list[Row], across: Callable[[Row], float], up: Callable[[Row], float]) -> None:
    names = list(dict.fromkeys(row.codec for row in rows))
    for index, name in enumerate(names):
        points = sorted((across(row), up(row)) for row in rows if row.codec == name)
        axes.plot(*zip(*points, strict=True), "o-", color=f"C{index % 10}", markersize=4, linewidth=1.0, label=name,
                  alpha=0.9, markerfacecolor=f"C{index % 10}" if index < 10 else "white")  # fmt: skip
    axes.set_yscale("log")
    axes.grid(linewidth=0.4, alpha=0.5, which="both")
    axes.spines[["top", "right"]].set_visible(False)


def _finish(plt: Any, figure: Any, title: str, file: Path) -> Path:
    figure.suptitle(title, fontsize=11)
    figure.savefig(file, dpi=150)
    plt.close(figure)
    return file
