"""Draw what rate_distortion.py measured: packets and bytes against error with the optimum, and time against error."""

import argparse
import json
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

from hapticnet.experiment.style import INK, draw_codecs, finish_axes

OURS: Final = "adaptive-predictive"
SHOWN: Final = {"scene": 1, "recorded": 2, "made": 3}
"""How many signals of each kind are drawn at most, the last ones of it; four in all."""

DPI: Final = 90

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
    draw_rates(results, folder / "rate_distortion.png")
    draw_cost(results, folder / "codec_cost.png")


def draw_rates(results: Row, file: Path) -> None:
    """Draw a column for each of a few signals: packets above, bytes below."""
    own = plain_rows(results["rows"])
    trials: list[str] = []
    for kind, most in SHOWN.items():
        names = [row["name"] for row in results["signals"] if row["kind"] == kind]
        trials += names[-min(most, 4 - len(trials)) :]
    figure, axes = plt.subplots(2, len(trials), figsize=(4.0 * len(trials), 7.6), layout="constrained", squeeze=False)
    for column, trial in enumerate(trials):
        block = [row for row in own if row["trial"] == trial]
        packets, size = axes[:, column]
        draw_codecs(packets, points(block, "packets_per_s", 1.0), highlight=OURS)
        draw_codecs(size, points(block, "wire_bytes_per_s", 1e-3), highlight=OURS)
        # Drawn over the deadband's error, which that rule's optimum has about as well.
        deadband = sorted((row for row in block if row["codec"] == "deadband"), key=lambda row: row["multiplier"])
        seconds = block[0]["sent"] / block[0]["packets_per_s"]
        for key, style, label in (("optimum_holds", "--", "fewest, hold"), ("optimum_lines", ":", "fewest, lines")):
            rates = [row[key] / seconds for row in deadband]
            packets.plot([row["rmse_n"] for row in deadband], rates, style, marker="_", color=INK, label=label)
        packets.set_title(trial, fontsize=11)
        finish_axes(packets, across="log")
        finish_axes(size, across="log")
        size.set_xlabel("RMSE of the applied force [N]")
    axes[0, 0].set_ylabel("packets/s")
    axes[1, 0].set_ylabel("kB/s, headers included")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=9, frameon=False
    )
    figure.savefig(file, dpi=DPI)
    plt.close(figure)


def draw_cost(results: Row, file: Path) -> None:
    """Draw the time for a sample over the error, both means over the first set of signals."""
    first = next(iter(results["sets"]))
    own = [row for row in plain_rows(results["averages"]) if row["signals"] == first]
    figure, axes = plt.subplots(figsize=(7.6, 4.6), layout="constrained")
    draw_codecs(axes, points(own, "nanoseconds_per_sample", 1e-3), highlight=OURS)
    finish_axes(axes, across="log")
    axes.set_xlabel(f"RMSE of the applied force [N], mean over {first}")
    axes.set_ylabel("encoding and decoding in a stream,\nplain Python [µs/sample]")
    figure.legend(loc="outside right upper", fontsize=9, frameon=False)
    figure.savefig(file, dpi=DPI)
    plt.close(figure)


def plain_rows(rows: list[Row]) -> list[Row]:
    """Return the rows without loss and with float32 payloads of all codecs but raw."""
    return [row for row in rows if not row["loss"] and not row["step_n"] and row["codec"] != "raw"]


def points(rows: list[Row], key: str, factor: float) -> dict[str, list[tuple[float, float]]]:
    """Return a figure over the error for each codec, in the order of the thresholds."""
    found: dict[str, list[tuple[float, float]]] = {}
    for row in sorted(rows, key=lambda row: row["multiplier"]):
        found.setdefault(row["codec"], []).append((row["rmse_n"], factor * row[key]))
    return found


if __name__ == "__main__":
    main()
