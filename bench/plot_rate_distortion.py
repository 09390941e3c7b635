"""Draw what rate_distortion.py measured: packets and bytes against error with the optimum, and time against error."""

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

INK = "#222222"
OURS = "adaptive-predictive"
RATE_SIGNALS = 4
DPI = 90

Row = dict[str, Any]


def main() -> None:
    """Read the results and write both pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, help="rate_distortion.json")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where to write; default: beside the results")
    arguments = parser.parse_args()
    results = json.loads(arguments.results.read_text(encoding="utf-8"))["results"]
    folder = arguments.out or arguments.results.parent
    folder.mkdir(parents=True, exist_ok=True)
    draw_rates(results["rows"], folder / "rate_distortion.png")
    draw_cost(results["averages"], folder / "codec_cost.png")


def draw_rates(rows: list[Row], file: Path) -> None:
    """Draw a column for each of a few signals: packets above, bytes below."""
    own = [row for row in rows if not row["loss"] and not row["step_n"] and row["codec"] != "raw"]
    trials = list(dict.fromkeys(row["trial"] for row in own))
    # The paper's scene once, then what is least like it: the last ones are the recordings, if there are any.
    shown = [trials[0], *[trial for trial in trials if not trial.startswith("paper's scene")][-(RATE_SIGNALS - 1) :]]
    figure, axes = plt.subplots(2, len(shown), figsize=(4.0 * len(shown), 7.6), layout="constrained", squeeze=False)
    for column, trial in enumerate(shown):
        block = [row for row in own if row["trial"] == trial]
        packets, size = axes[0, column], axes[1, column]
        seconds = block[0]["sent"] / block[0]["packets_per_s"]
        draw_codecs(packets, block, "packets_per_s", 1.0)
        draw_codecs(size, block, "wire_bytes_per_s", 1e-3)
        for key, style, label in (("optimum_holds", "--", "optimum, hold"), ("optimum_lines", ":", "optimum, lines")):
            # Drawn over the deadband's error, which that rule's optimum has about as well.
            plain = sorted((row for row in block if row["codec"] == "deadband"), key=lambda row: row["multiplier"])
            packets.plot(
                [row["rmse_n"] for row in plain],
                [max(row[key], 0.1) / seconds for row in plain],
                style,
                marker="_",
                color=INK,
                linewidth=1.2,
                label=label,
            )
        packets.set_title(trial, fontsize=11)
        packets.set_xscale("log")
        size.set_xscale("log")
        size.set_xlabel("RMSE of the applied force [N]")
    axes[0, 0].set_ylabel("packets/s")
    axes[1, 0].set_ylabel("kB/s, headers included")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    figure.savefig(file, dpi=DPI)
    plt.close(figure)


def draw_cost(averages: list[Row], file: Path) -> None:
    """Draw the time for a sample over the error, both means over the signals."""
    own = [row for row in averages if not row["loss"] and not row["step_n"] and row["codec"] != "raw"]
    figure, axes = plt.subplots(figsize=(7.6, 4.6), layout="constrained")
    draw_codecs(axes, own, "nanoseconds_per_sample", 1e-3)
    axes.set_xlabel("RMSE of the applied force [N], mean over the signals")
    axes.set_ylabel("encoding and decoding in a stream,\nplain Python [µs/sample]")
    figure.legend(loc="outside right upper", fontsize=9, frameon=False)
    figure.savefig(file, dpi=DPI)
    plt.close(figure)


def draw_codecs(axes: Axes, rows: list[Row], key: str, factor: float) -> None:
    """Draw a line for each codec, a point for each threshold."""
    for index, name in enumerate(dict.fromkeys(row["codec"] for row in rows)):
        points = sorted((row["multiplier"], row["rmse_n"], factor * row[key]) for row in rows if row["codec"] == name)
        axes.plot(
            [error_n for _, error_n, _ in points],
            [value for _, _, value in points],
            "o-",
            color=f"C{index % 10}",
            markersize=6 if name == OURS else 4,
            linewidth=2.2 if name == OURS else 1.0,
            zorder=3 if name == OURS else 2,
            label=name,
        )
    axes.set_yscale("log")
    axes.grid(linewidth=0.4, alpha=0.5, which="both")
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main()
