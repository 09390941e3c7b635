"""The demo's pictures: bytes per penetration, and a stretch of true, transmitted, held and sensed force."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from hapticnet.experiment.analysis import STAMP_MODULUS
from hapticnet.experiment.demo import Played
from hapticnet.experiment.style import INK, pyplot

TISSUES: Final = 3
MARGIN_S: Final = 0.25

TRUE_COLOUR: Final = "#222222"
HELD_COLOUR: Final = "#1f77b4"
SENSED_COLOUR: Final = "#d9822b"
PAPER_COLOUR: Final = "#b03a2e"
BAR_COLOURS: Final = ("#9aa5b1", "#1f77b4", "#4a9bd1", "#8cc4e8")


def draw_bytes_per_penetration(rows: list[dict[str, Any]], file: Path) -> None:
    """Draw the paper's Fig. 4: mean bytes per penetration in each condition, with every penetration as a dot."""
    plt = pyplot()
    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    rng = np.random.default_rng(0)
    top = max(max([row["bytes_per_penetration"], *row["bytes_of_each_penetration"]]) for row in rows)
    for place, row in enumerate(rows):
        mean, each = row["bytes_per_penetration"], row["bytes_of_each_penetration"]
        axes.bar(place, mean, width=0.62, color=BAR_COLOURS[place], zorder=2)
        axes.errorbar(place, mean, yerr=row["bytes_deviation"], color=INK, capsize=5, linewidth=1.2, zorder=3)
        axes.scatter(place + rng.uniform(-0.2, 0.2, len(each)), each, s=9, color=INK, alpha=0.35, linewidth=0, zorder=4)
        label = f"{mean:,.0f} B" + (f"\n−{row['byte_reduction']:.1%}" if place else "")
        highest = max([mean + row["bytes_deviation"], *each])
        axes.annotate(label, (place, highest + 0.02 * top), ha="center", va="bottom", zorder=5)
        if row["paper_byte_reduction"]:
            paper = (1.0 - row["paper_byte_reduction"]) * rows[0]["bytes_per_penetration"]
            axes.plot([place - 0.36, place + 0.36], [paper, paper], color=PAPER_COLOUR, linestyle="--", zorder=5)
            axes.annotate(
                f"paper: −{row['paper_byte_reduction']:.1%}", (place + 0.4, paper), va="center", color=PAPER_COLOUR
            )
    axes.set_xticks(range(len(rows)), [row["condition"] for row in rows])
    axes.set_ylim(0, 1.22 * top if top else 1)
    axes.set_ylabel("feedback bytes per penetration\n(keepalives and UDP/IPv4 headers included)")
    axes.set_xlabel("deadband threshold")
    axes.set_title("Bytes per penetration: mean, standard deviation, every penetration", fontsize=10)
    axes.grid(axis="y", linewidth=0.4, alpha=0.5, zorder=0)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def draw_force_stretch(played: Played, file: Path) -> None:
    """Draw a condition's first insertion: true and transmitted force above, held and sensed force below."""
    plt = pyplot()
    slave, master = played.slave_samples, played.master_samples
    slave_s, master_s = _seconds(slave["t_us"], master["t_us"][0]), _seconds(master["t_us"], master["t_us"][0])
    start_s, end_s = _first_insertion(slave_s, slave["force_n"], slave["breaches"])
    sent = slave["transmitted"] > 0
    figure, (above, below) = plt.subplots(2, 1, figsize=(9, 6), sharex=True, sharey=True, layout="constrained")
    above.plot(slave_s, slave["force_n"], color=TRUE_COLOUR, linewidth=1.0, label="true force (slave)")
    above.scatter(
        slave_s[sent], slave["held_n"][sent], s=9, color=HELD_COLOUR, zorder=3, linewidth=0, label="transmitted"
    )
    below.plot(slave_s, slave["force_n"], color=TRUE_COLOUR, linewidth=0.7, alpha=0.45, label="true force (slave)")
    below.step(master_s, master["held_n"], where="post", color=HELD_COLOUR, linewidth=1.2, label="held (master)")
    below.plot(master_s, master["sensed_n"], color=SENSED_COLOUR, linewidth=1.1, label="sensed at the fingertip")
    for axes in (above, below):
        axes.set_ylabel("force [N]")
        axes.grid(linewidth=0.4, alpha=0.5)
        axes.legend(loc="upper left", frameon=False, fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
    within = (slave_s >= start_s) & (slave_s <= end_s)
    share = f"{int(sent[within].sum())} of {int(within.sum())} samples transmitted"
    above.set_title(f"{played.condition.name}, first insertion: {share}", fontsize=10)
    above.set_xlim(start_s, end_s)
    below.set_xlabel("time [s]")
    figure.savefig(file, dpi=150)
    plt.close(figure)


def _first_insertion(t_s: Any, force_n: Any, breaches: Any) -> tuple[float, float]:
    """Return a little before the first touch and a little after the third breach [s]; all there is without either."""
    touching, through = np.flatnonzero(force_n > 0.0), np.flatnonzero(breaches >= TISSUES)
    start_s = t_s[touching[0]] - MARGIN_S if len(touching) else t_s[0]
    return start_s, t_s[through[0]] + 2 * MARGIN_S if len(through) else t_s[-1]


def _seconds(t_us: Any, zero_us: float) -> Any:
    """Return times [s] after `zero_us`, whichever side's unwrapping they come from."""
    half = STAMP_MODULUS / 2
    return ((t_us - zero_us + half) % STAMP_MODULUS - half) / 1e6
