"""Draw what scene_accuracy.py measured: the error that is left at each rate of the scene, and what the rate costs."""

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

Row = dict[str, Any]


def main() -> None:
    """Read the results and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, help="scene_accuracy.json")
    parser.add_argument("--out", type=Path, metavar="FILE", help="picture to write; default: beside the results")
    arguments = parser.parse_args()
    results = json.loads(arguments.results.read_text(encoding="utf-8"))["results"]
    figure, (errors, late, cost) = plt.subplots(1, 3, figsize=(12.5, 4.2), layout="constrained")
    for index, name in enumerate(dict.fromkeys(row["law"] for row in results["forces"])):
        rows = [row for row in results["forces"] if row["law"] == name]
        rates_hz = [row["rate_hz"] for row in rows]
        errors.plot(rates_hz, [row["max_held_n"] for row in rows], "o-", color=f"C{index}", label=f"{name}, largest")
        errors.plot(rates_hz, [row["rmse_held_n"] for row in rows], "o:", color=f"C{index}", label=f"{name}, RMSE")
    errors.set_ylabel("error of the held force [N]")
    errors.legend(fontsize=8, frameon=False)
    rates_hz = [row["rate_hz"] for row in results["breaches"]]
    late.plot(rates_hz, [row["late_max_ms"] for row in results["breaches"]], "o-", label="largest")
    late.plot(rates_hz, [row["late_mean_ms"] for row in results["breaches"]], "o:", label="mean")
    late.plot(rates_hz, [1e3 / rate_hz for rate_hz in rates_hz], color="#9aa5b1", label="one period")
    late.set_ylabel("a breach is noticed so late [ms]")
    late.legend(fontsize=8, frameon=False)
    spent_us = [row["ns_per_second_best"] / 1000.0 for row in results["cost"]]
    cost.plot([row["rate_hz"] for row in results["cost"]], spent_us, "o-")
    cost.set_ylabel("time for a second of the paper's scene [µs]")
    for axes in (errors, late, cost):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("rate of the scene [Hz]")
        axes.grid(linewidth=0.4, alpha=0.5, which="both")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(arguments.out or arguments.results.with_suffix(".png"), dpi=90)


if __name__ == "__main__":
    main()
