"""The figure of a signal: true and applied force, the samples that are sent, and the error over time; and of a run."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.errors import SettingsError
from hapticnet.experiment.analysis import Columns, matched, vectors
from hapticnet.experiment.style import BLUE, INK, ORANGE, SKY, VERMILION, legend, legend_above, picture
from hapticnet.perception import WeberLaw

HEIGHT_IN: Final = 4.4
HEIGHTS: Final = (3.0, 0.55, 1.3)  # relative heights of force, sent samples and error
RUN_WIDTH_IN: Final = 8.0
RUN_HEIGHT_IN: Final = 4.4  # at the 150 dots per inch of that figure, 1200 by 660 pixels
TISSUES: Final = 3
MARGIN_S: Final = 0.25
ZOOM_S: Final = 0.32  # how long before the last breach the magnified part of the figure of a run begins [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A force and what the other side applies: times [s], shape (n,), and forces [N], shape (n, a)."""

    t_s: FloatArray
    true_n: FloatArray
    applied_n: FloatArray
    sent: IntArray  # indices of the samples that were sent
    lost: IntArray  # indices of those among them that were lost
    law: WeberLaw  # the law whose threshold is drawn
    felt_n: FloatArray | None = None  # force at the fingertip [N], shape (n,), if there is a finger


def check_window(window_s: tuple[float, float], name: str, end_s: float) -> None:
    """Raise SettingsError unless a stretch between two times [s] begins within a recording that ends at `end_s`."""
    start_s, stop_s = window_s
    if not 0.0 <= start_s < stop_s < math.inf:
        raise SettingsError(f"window from {start_s:g} to {stop_s:g} s: it must go forward, from 0 s on")
    if start_s >= end_s:
        raise SettingsError(f"window from {start_s:g} to {stop_s:g} s: {name} ends at {end_s:g} s")


def draw_signal(signal: Signal, file: Path, *, window_s: tuple[float, float], title: str) -> None:
    """Draw a stretch of a signal into a file; see `fill_figure`."""
    with picture(file, HEIGHT_IN) as figure:
        fill_figure(figure, signal, window_s=window_s, title=title)


def fill_figure(figure: Any, signal: Signal, *, window_s: tuple[float, float], title: str) -> None:
    """Draw force, samples sent and error into an empty figure. On several axes, force and error are magnitudes."""
    one_axis = signal.true_n.shape[1] == 1
    force, sent, error = figure.subplots(3, 1, sharex=True, height_ratios=HEIGHTS)
    draw_force(force, signal, window_s)
    legend_above(force)
    figure.suptitle(title + describe_extract(signal, window_s), fontsize=9)
    share = draw_sent(sent, signal, window_s)
    sent.set_title(share, loc="left", color=BLUE)
    shown = _shown(signal, window_s)
    difference = signal.applied_n[shown] - signal.true_n[shown]
    error_n = difference[:, 0] if one_axis else np.linalg.norm(difference, axis=1)
    threshold_n = signal.law.thresholds_n(np.linalg.norm(signal.applied_n[shown], axis=1))
    t_s = signal.t_s[shown]
    error.fill_between(t_s, -threshold_n, threshold_n, color=SKY, alpha=0.35, linewidth=0, label="threshold")
    error.plot(t_s, error_n, color=INK, linewidth=0.7, label="error")
    error.set_ylabel("error [N]" if one_axis else "|error| [N]")
    if not one_axis:
        error.set_ylim(bottom=0.0)
    legend_above(error)
    error.set_xlabel("time [s]")
    error.set_xlim(window_s)


def describe_extract(signal: Signal, window_s: tuple[float, float]) -> str:
    """Return the part of a title that names the stretch of a signal shown; "" if it is all of it."""
    start_s, end_s = float(signal.t_s[0]), float(signal.t_s[-1])
    if window_s[0] <= start_s and window_s[1] >= end_s:
        return ""
    first, last, whole = (f"{round(s, 2):g}" for s in (max(window_s[0], start_s), min(window_s[1], end_s), end_s))
    return f", {first} to {last} s of {whole} s"


def draw_force(axes: Any, signal: Signal, window_s: tuple[float, float], *, width: float = 1.0) -> None:
    """Draw true and applied force, and the force at the fingertip if there is one, in lines of `width` points."""
    shown = _shown(signal, window_s)
    t_s, one_axis = signal.t_s[shown], signal.true_n.shape[1] == 1
    true_n, applied_n = (
        values[shown, 0] if one_axis else np.linalg.norm(values[shown], axis=1)
        for values in (signal.true_n, signal.applied_n)
    )
    axes.plot(t_s, true_n, color=INK, linewidth=0.9 * width, label="true force")
    axes.step(t_s, applied_n, where="post", color=BLUE, linewidth=1.1 * width, label="applied (held) force")
    if signal.felt_n is not None:
        felt_n = signal.felt_n[shown]
        axes.plot(
            t_s, felt_n, color=VERMILION, linewidth=width, linestyle=(0, (4, 1.5)), label="force at the fingertip"
        )
    axes.set_ylabel("force [N]" if one_axis else "|force| [N]")


def draw_sent(axes: Any, signal: Signal, window_s: tuple[float, float]) -> str:
    """Draw a tick for each sample that was sent, and return their share of all."""
    shown = _shown(signal, window_s)
    sent, lost = (indices[shown[indices]] for indices in (signal.sent, signal.lost))
    axes.vlines(signal.t_s[sent], 0.0, 1.0, color=BLUE, linewidth=0.6)
    if len(lost):
        axes.vlines(signal.t_s[lost], -0.6, 0.0, color=VERMILION, linewidth=0.6)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)
    axes.set_ylabel("sent", rotation=0, ha="right", va="center")
    count = int(shown.sum())
    if not count:
        return "no samples"
    saved = f"{len(sent):,} of {count:,} samples sent: {1 - len(sent) / count:.1%} fewer packets"
    return saved + (f", {len(lost):,} lost (orange)" if len(lost) else "")


def _shown(signal: Signal, window_s: tuple[float, float]) -> npt.NDArray[np.bool_]:
    shown: npt.NDArray[np.bool_] = (signal.t_s >= window_s[0]) & (signal.t_s <= window_s[1])
    return shown


def draw_run(slave: Columns, master: Columns, file: Path, *, codec: str) -> None:
    """Draw the first insertion of a run from the recordings of both sides, its last breach magnified beside it."""
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
                title = f"{codec}: first insertion{describe_extract(signal, window_s)}\n{share}"
                figure.suptitle(title, color=BLUE, fontweight="bold")
        force.axvspan(*near_s, color=ORANGE, alpha=0.2, linewidth=0)
        legend(figure, force)
        near.set_facecolor("#fdf5e6")
        near.set_title("the shaded part, magnified")
        near.set_ylabel("")
        near_sent.set_ylabel("")


def _windows(signal: Signal, breaches: FloatArray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the first insertion and the time around its last breach [s]; everything if nothing is breached."""
    t_s = signal.t_s
    touching, through = np.flatnonzero(signal.true_n.any(axis=1)), np.flatnonzero(breaches >= TISSUES)
    start_s = max(t_s[touching[0]] - MARGIN_S, 0.0) if len(touching) else 0.0
    breach_s = t_s[through[0]] if len(through) else t_s[-1]
    return (start_s, min(breach_s + MARGIN_S, t_s[-1])), (breach_s - ZOOM_S, breach_s + ZOOM_S / 8)
