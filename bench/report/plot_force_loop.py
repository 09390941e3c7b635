"""Draw what force_loop.py measured: the step on each finger, and what the control rate costs and gains."""

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import NullLocator

from hapticnet.experiment.style import INK

SETTLING_COLOUR = "#1f77b4"
RIPPLE_COLOUR = "#d9822b"
FROM_N, TO_N = 0.4, 2.0
APART_N = 0.5
USUAL_N_M = 1000.0

Row = dict[str, Any]


def main() -> None:
    """Read the results and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, help="force_loop.json")
    parser.add_argument("--out", type=Path, metavar="FILE", help="picture to write; default: beside the results")
    arguments = parser.parse_args()
    results = json.loads(arguments.results.read_text(encoding="utf-8"))["results"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.5, 5.4), layout=ConstrainedLayoutEngine(wspace=0.06))
    draw_steps(left, results["step"])
    draw_rates(right, results["rates"])
    for axes in (left, right):
        axes.grid(linewidth=0.4, alpha=0.5)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(arguments.out or arguments.results.with_suffix(".png"), dpi=150)


def draw_steps(axes: Axes, rows: list[Row]) -> None:
    """Draw the step responses one above the other, the target behind each."""
    for index, row in enumerate(rows):
        raised_n = APART_N * index
        trace = row["trace"]
        t_ms = [1e3 * t_s for t_s in trace["t_s"]]
        colour = plt.get_cmap("viridis")(0.9 * index / max(1, len(rows) - 1))
        axes.plot(
            [t_ms[0], 0.0, 0.0, t_ms[-1]],
            [FROM_N + raised_n] * 2 + [TO_N + raised_n] * 2,
            color=INK,
            linewidth=0.8,
            alpha=0.5,
            label="target" if index == 0 else None,
        )
        for name, style, label in (("sensed_n", "-", "sensed"), ("true_n", ":", "true")):
            axes.plot(
                t_ms,
                [force_n + raised_n for force_n in trace[name]],
                style,
                color=colour,
                linewidth=1.3,
                label=label if index == 0 else None,
            )
        axes.annotate(
            f"{row['stiffness_n_m'] / 1000:g} N/mm" + (f", +{raised_n:g} N" if index else ""),
            (t_ms[-1], TO_N + raised_n),
            xytext=(0, -14),
            textcoords="offset points",
            ha="right",
            color=colour,
        )
    axes.set_xlabel("time since the step [ms]")
    axes.set_ylabel(f"force [N], each finger raised by {APART_N:g} N")
    axes.set_title(f"{FROM_N:g} to {TO_N:g} N on any finger, nothing retuned", fontsize=11)
    axes.legend(loc="lower right", frameon=False, fontsize=9)


def draw_rates(axes: Axes, rows: list[Row]) -> None:
    """Draw settling and the ripple that the loop sees over the control rate, with processor time."""
    rates_hz = [row["rate_hz"] for row in rows]
    usual = [next(finger for finger in row["fingers"] if finger["stiffness_n_m"] == USUAL_N_M) for row in rows]
    ripple = axes.twinx()
    ripple.spines["top"].set_visible(False)
    for where, force, name, factor, colour, label in (
        (axes, "true", "settling_s", 1e3, SETTLING_COLOUR, "5 % settling of the true force"),
        (ripple, "sensed", "ripple_peak_to_peak_n", 1e3, RIPPLE_COLOUR, "ripple of the averaged reading"),
    ):
        for which, style in (("median", "o-"), ("worst", "o:")):
            values = [finger[force][name][which] for finger in usual]
            where.plot(
                rates_hz,
                [float("nan") if value is None else factor * value for value in values],
                style,
                color=colour,
                markersize=5,
                linewidth=1.3 if which == "median" else 0.9,
                label=f"{label}, {which}",
            )
    axes.set_xscale("log")
    axes.set_xticks(rates_hz, [f"{row['rate_hz']}\nCPU {row['cpu_ratio']:.2f}×" for row in rows])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_ylim(0.0, 400.0)
    ripple.set_ylim(0.0, 80.0)
    axes.set_xlabel("control rate [Hz]")
    axes.set_ylabel("5 % settling [ms]", color=SETTLING_COLOUR)
    ripple.set_ylabel("ripple, peak to peak [mN]", color=RIPPLE_COLOUR)
    axes.set_title(f"Speed against error, {USUAL_N_M / 1000:g} N/mm", fontsize=11)
    lines = [*axes.get_lines(), *ripple.get_lines()]
    axes.legend(lines, [line.get_label() for line in lines], loc="upper center", frameon=False, fontsize=9)


if __name__ == "__main__":
    main()
