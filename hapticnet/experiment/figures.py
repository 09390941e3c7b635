"""The demo's figures: bytes per penetration, and a run over time."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.experiment.analysis import Columns, matched, vectors
from hapticnet.experiment.signal_figure import Signal, draw_force, draw_sent, told_extract
from hapticnet.experiment.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, SKY, VERMILION, legend, picture
from hapticnet.perception import WeberLaw

TISSUE_LOOKS: Final = (("o", VERMILION), ("s", GREEN), ("^", PURPLE), ("D", ORANGE))

RUN_WIDTH_IN: Final = 8.0
RUN_HEIGHT_IN: Final = 4.4
"""At the 150 dots per inch of that figure, 1200 by 660 pixels."""

TISSUES: Final = 3
MARGIN_S: Final = 0.25
ZOOM_S: Final = 0.32
"""How long before the last breach the magnified part of the figure of a run begins [s]."""


def draw_bytes_per_penetration(rows: list[dict[str, Any]], file: Path) -> None:
    """Draw the paper's Fig. 4: mean bytes per penetration in each condition, with every penetration by tissue."""
    with picture(file, 4.2) as figure:
        axes = figure.subplots()
        top = max(max([row["bytes_per_penetration"], *row["bytes_of_each_penetration"]]) for row in rows)
        for place, row in enumerate(rows):
            mean, each = row["bytes_per_penetration"], row["bytes_of_each_penetration"]
            axes.bar(place, mean, width=0.62, color=SKY if place else GREY, zorder=2)
            axes.errorbar(place, mean, yerr=row["bytes_deviation"], color=INK, capsize=5, linewidth=1.2, zorder=3)
            for number, tissue in enumerate(row["bytes_of_each_tissue"]):
                marker, colour = TISSUE_LOOKS[number % len(TISSUE_LOOKS)]
                axes.plot(
                    place + 0.085 * (number + 1) + np.linspace(-0.02, 0.02, len(tissue["each"])),
                    tissue["each"],
                    marker,
                    color=colour,
                    markersize=4.5,
                    markeredgecolor="white",
                    markeredgewidth=0.4,
                    zorder=4,
                    label=None if place else f"{tissue['tissue']}, breaks at {tissue['breach_force_n']:g} N",
                )
            saved = "" if row["byte_reduction"] is None else f"\n−{row['byte_reduction']:.1%}"
            label = f"{mean:,.0f} B" + (saved if place else "")
            highest = max([mean + row["bytes_deviation"], *each])
            axes.annotate(label, (place, highest + 0.02 * top), ha="center", va="bottom", zorder=5)
            if row["paper_byte_reduction"] and row["counted"] == "penetration":
                paper = (1.0 - row["paper_byte_reduction"]) * rows[0]["bytes_per_penetration"]
                axes.plot([place - 0.36, place + 0.36], [paper, paper], color=BLUE, linestyle="--", zorder=5)
                told = f"paper: −{row['paper_byte_reduction']:.1%}"
                axes.annotate(told, (place + 0.4, paper), va="center", color=BLUE)
        axes.set_xticks(range(len(rows)), [row["condition"] for row in rows])
        axes.grid(visible=False, axis="x")
        axes.set_ylim(0, 1.22 * top if top else 1)
        counted = rows[0]["counted"]
        axes.set_ylabel(f"feedback bytes per {counted}\n(with keepalives and UDP/IPv4 headers)")
        axes.set_xlabel("deadband threshold")
        axes.set_title(f"Bytes per {counted}: mean, standard deviation, every {counted}")
        legend(figure, axes)


def draw_run(slave: Columns, master: Columns, file: Path, *, codec: str) -> None:
    """Draw the first insertion of a run from the recordings of both sides, its last breach magnified beside it.

    Parameters
    ----------
    codec
        Codec and threshold for the title, such as "deadband, 1 JND".
    """
    at_slave, at_master = matched(slave, master)
    stamps_us = slave["t_us"][at_slave]
    signal = Signal(
        t_s=(stamps_us - stamps_us[0]) * 1e-6,
        true_n=vectors(slave, "force", "n")[at_slave],
        applied_n=vectors(slave, "held", "n")[at_slave],
        sent=np.flatnonzero(slave["transmitted"][at_slave] > 0),
        lost=np.empty(0, dtype=np.int64),
        law=WeberLaw(),
        felt_n=master["sensed_n"][at_master],
    )
    insertion_s, near_s = _windows(signal, slave["breaches"][at_slave])
    settings = {"font_size": 11.0, "axes_titlesize": 11.5, "savefig_dpi": 150}
    with picture(file, RUN_HEIGHT_IN, width_in=RUN_WIDTH_IN, **settings) as figure:
        (force, near), (sent, near_sent) = figure.subplots(
            2, 2, sharex="col", height_ratios=(4.4, 0.8), width_ratios=(2.1, 1)
        )
        for axes, ticks, window_s in ((force, sent, insertion_s), (near, near_sent, near_s)):
            draw_force(axes, signal, window_s, width=1.6)
            share = draw_sent(ticks, signal, window_s)
            ticks.set_xlabel("time [s]")
            ticks.set_xlim(window_s)
            if axes is force:
                title = f"{codec}: first insertion{told_extract(signal, window_s)}\n{share}"
                figure.suptitle(title, color=BLUE, fontweight="bold")
        force.axvspan(*near_s, color=ORANGE, alpha=0.2, linewidth=0)
        legend(figure, force)
        near.set_facecolor("#fdf5e6")
        near.set_title("the shaded part, magnified")
        near.set_ylabel("")
        near_sent.set_ylabel("")


def _windows(signal: Signal, breaches: FloatArray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the first insertion and the time around its last breach [s]; all there is if nothing is breached."""
    t_s = signal.t_s
    touching, through = np.flatnonzero(signal.true_n.any(axis=1)), np.flatnonzero(breaches >= TISSUES)
    start_s = max(t_s[touching[0]] - MARGIN_S, 0.0) if len(touching) else 0.0
    breach_s = t_s[through[0]] if len(through) else t_s[-1]
    return (start_s, min(breach_s + MARGIN_S, t_s[-1])), (breach_s - ZOOM_S, breach_s + ZOOM_S / 8)
