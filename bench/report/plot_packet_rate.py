"""Draw what packet_rate.py measured: saving over the sampling rate, and saving over the error it costs."""

import argparse
import json
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, NullLocator

INK = "#222222"
GREY = "#9aa5b1"
PAPER_COLOUR = "#c0392b"
COLOURS = {"none": GREY, "1 JND": "#1f77b4", "2 JND": "#d9822b", "4 JND": "#2a9d6f"}
TRACE_MARKERS = "DsX^vP"
REDUCTIONS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998)

Row = dict[str, Any]


def main() -> None:
    """Read the results and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, help="packet_rate.json")
    parser.add_argument("--out", type=Path, metavar="FILE", help="picture to write; default: beside the results")
    arguments = parser.parse_args()
    results = json.loads(arguments.results.read_text(encoding="utf-8"))["results"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.5, 5.4), layout=ConstrainedLayoutEngine(wspace=0.06))
    draw_rates(left, results)
    draw_errors(right, results)
    for axes in (left, right):
        axes.grid(linewidth=0.4, alpha=0.5)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(arguments.out or arguments.results.with_suffix(".png"), dpi=150)


def draw_rates(axes: Axes, results: Row) -> None:
    """Draw byte reduction per penetration over the sampling rate, and where the paper's falls."""
    scripted_s = results["motion"]["push_s"]
    others = [curve for curve in results["over_speeds"] if curve["push_s"] != scripted_s]
    for curve, dashes in zip(others, ("-", "--", "-.", ":"), strict=False):
        axes.plot(
            [row["rate_hz"] for row in curve["rows"]],
            [100 * row["byte_reduction"] for row in curve["rows"]],
            dashes,
            color=COLOURS["1 JND"],
            alpha=0.55,
            linewidth=1.1,
            label=f"1 JND, push of {curve['push_s']:g} s",
        )
    for condition, rows in by(results["scene"], "condition"):
        if condition != "none":
            axes.plot(
                [row["rate_hz"] for row in rows],
                [100 * row["byte_reduction"] for row in rows],
                "o-",
                color=COLOURS[condition],
                markersize=5,
                label=f"{condition}, push of {scripted_s:g} s",
                zorder=3,
            )
    paper = 100 * results["paper_byte_reduction"]
    axes.axhline(paper, color=PAPER_COLOUR, linewidth=1.0, zorder=2)
    scripted = next(curve for curve in results["over_speeds"] if curve["push_s"] == scripted_s)
    if scripted["crossing_hz"]:
        axes.plot(scripted["crossing_hz"], paper, "o", color=PAPER_COLOUR, markersize=9, fillstyle="none", zorder=4)
        axes.annotate(
            f"the paper's {paper:.1f} % at 1 JND:\n{scripted['crossing_hz']:.0f} Hz with this motion",
            (scripted["crossing_hz"], paper),
            xytext=(48, -50),
            textcoords="offset points",
            color=PAPER_COLOUR,
            arrowprops={"arrowstyle": "-", "color": PAPER_COLOUR, "linewidth": 0.8, "shrinkB": 5},
        )
    axes.set_xscale("log")
    rates_hz = sorted({row["rate_hz"] for row in results["scene"]})
    axes.set_xticks(rates_hz, [f"{rate_hz:g}" for rate_hz in rates_hz])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_ylim(18, 101)
    axes.set_xlabel("sampling rate [Hz]")
    axes.set_ylabel("fewer bytes per penetration than without compression [%]\n(UDP/IPv4 headers included)")
    axes.set_title("Saving depends on sampling rate and motion", fontsize=11)
    axes.legend(loc="lower right", ncols=2, frameon=False, fontsize=9)


def draw_errors(axes: Axes, results: Row) -> None:
    """Draw packet-rate reduction over root mean square error, for the scene and the recorded traces."""
    for rate_hz, rows in by(results["scene"], "rate_hz"):
        errors_n, left = [row["rmse_n"] for row in rows], [1 - row["packet_rate_reduction"] for row in rows]
        axes.plot(errors_n, left, color=GREY, linewidth=0.9, zorder=1)
        axes.annotate(
            f"{rate_hz:g} Hz",
            (errors_n[-1], left[-1]),
            xytext=(9, 0),
            textcoords="offset points",
            va="center",
            color=INK,
        )
    for condition, rows in by(results["scene"], "condition"):
        axes.scatter(
            [row["rmse_n"] for row in rows],
            [1 - row["packet_rate_reduction"] for row in rows],
            color=COLOURS[condition],
            s=26,
            zorder=3,
            label=f"scene, {condition}",
        )
    for (trace, rows), marker in zip(by(results["traces"], "trace"), TRACE_MARKERS, strict=False):
        errors_n, left = [row["rmse_n"] for row in rows], [1 - row["packet_rate_reduction"] for row in rows]
        axes.plot(errors_n, left, ":", color=INK, linewidth=0.9, zorder=2)
        axes.scatter(errors_n, left, c=[COLOURS[row["condition"]] for row in rows], marker=marker, s=44, zorder=4)
        axes.scatter([], [], color=INK, marker=marker, s=44, label=f"trace {trace}")
    axes.set_yscale("log")
    axes.set_yticks([1 - reduction for reduction in REDUCTIONS])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda left, _: f"{100 * (1 - left):g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.invert_yaxis()
    largest_n = max(row["rmse_n"] for row in [*results["scene"], *results["traces"]])
    axes.set_xlim(-0.03 * largest_n, 1.17 * largest_n)
    axes.set_xlabel("root mean square error of the applied force [N]")
    axes.set_ylabel("fewer packets than without compression, whole run [%]")
    axes.set_title("Saving against error, scene at each sampling rate", fontsize=11)
    axes.legend(loc="lower right", frameon=False, fontsize=9)


def by(rows: list[Row], key: str) -> list[tuple[Any, list[Row]]]:
    """Return rows grouped by a value, in the order in which its values first appear."""
    order = list(dict.fromkeys(row[key] for row in rows))
    ordered = sorted(rows, key=lambda row: order.index(row[key]))
    return [(value, list(group)) for value, group in groupby(ordered, key=itemgetter(key))]


if __name__ == "__main__":
    main()
