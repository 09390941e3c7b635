"""A figure of a study's results, with lines and panels for the values of some settings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import SettingsError
from hapticnet.experiment.style import LOG_MARK, PRINT_WIDTH_IN, check_format, draw_codecs, finish_axes, legend, picture
from hapticnet.experiment.summary import t_quantile
from hapticnet.sweep.query import Results, summary

LABELS: Final = {
    "packets_per_s": "packets/s",
    "wire_bytes_per_s": "B/s with headers",
    "felt_rmse_n": "RMS error of the felt force [N]",
    "felt_max_error_n": "largest error of the felt force [N]",
    "felt_exceed_jnd": "share of time above 1 JND",
    "felt_rms_jnd": "RMS distance of the felt force [JND]",
    "coded_rmse_n": "RMS error of the codec [N]",
    "correct": "share of correct orders",
    "bytes_per_penetration": "B per penetration",
    "multiplier": "threshold [JND]",
    "delay_ms": "delay of each way [ms]",
    "jitter_ms": "jitter [ms]",
    "loss": "share lost",
    "rate_hz": "positions/s",
}
MOST_PANELS: Final = 12
PANEL_HEIGHT_IN: Final = 2.3
ACROSS: Final = 3
"""Panels in a row, at most."""

MOST_DECADES: Final = 2.5
"""Decades up to which an axis of a panel has labels within a decade."""

LINEAR: Final = ("correct",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """What to draw.

    Attributes
    ----------
    x, y
        Columns of the axes: settings or measures. Of measures, the mean of each group is drawn.
    line, panel
        Columns with one line, and one panel, for each combination of their values; none: one.
    by
        If `x` is a measure, the columns with a point for each combination of their values. If it is a setting, there is
        a point for each of its values.
    """

    x: str
    y: str
    line: tuple[str, ...]
    panel: tuple[str, ...]
    by: tuple[str, ...]


def draw(results: Results, drawing: Drawing, file: Path, *, where: str | None = None) -> None:
    """Draw a figure into a file: the mean of each group of runs.

    Raises
    ------
    SettingsError
        If there is no such column, or there are too many panels.
    UnavailableError
        If matplotlib is missing.
    """
    check_format(file.suffix[1:])
    for option, name in (("--x", drawing.x), ("--y", drawing.y)):
        if name not in results.numbers:
            raise SettingsError(
                f"{option}: there is no column {name!r} of numbers; there are: {', '.join(results.numbers)}"
            )
    for option, settings in (("--line", drawing.line), ("--panel", drawing.panel)):
        for name in settings:
            if name not in results.settings:
                raise SettingsError(f"{option}: there is no setting {name!r}; there are: {', '.join(results.settings)}")
    panels = _panels(results, drawing, where)
    if len(panels) > MOST_PANELS:
        raise SettingsError(
            f"--panel {','.join(drawing.panel)} makes {len(panels)} panels; at most {MOST_PANELS} are drawn"
        )
    runs = max(runs for _, _, runs in panels)
    columns = 2 if len(panels) == 4 else min(ACROSS, len(panels))
    rows = -(-len(panels) // columns)
    with picture(file, 0.9 + PANEL_HEIGHT_IN * rows, width_in=PRINT_WIDTH_IN) as figure:
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, (title, lines, _) in zip(grid.flat, panels, strict=False):
            draw_codecs(axes, lines)
            axes.set_title(title)
        for axes in list(grid.flat)[len(panels) :]:
            axes.set_visible(False)
        whiskers = (
            f"; whiskers: 95 % interval of the mean over up to {runs:,} runs" if runs > 1 else "; one run a point"
        )
        figure.suptitle(results.about["name"] + whiskers, fontsize=9)
        _finish(figure, grid, drawing)


def _finish(figure: Any, grid: Any, drawing: Drawing) -> None:
    shown = [axes for axes in grid.flat if axes.get_visible()]
    if drawing.y not in LINEAR:  # errors and rates span decades; shares of answers do not
        finish_axes(*shown, across="log" if drawing.x.endswith("_per_s") else "linear")
        for axes in shown:
            _thin_out(axes)
    for axes in grid[-1]:
        axes.set_xlabel(LABELS.get(drawing.x, drawing.x))
    told = LABELS.get(drawing.y, drawing.y) + (LOG_MARK if grid.flat[0].get_yscale() == "log" else "")
    figure.supylabel(told, fontsize="medium")  # once: the panels share the axis
    if drawing.line:
        legend(figure, *shown)


def _thin_out(axes: Any) -> None:
    """Label decades only where an axis spans many of them."""
    from matplotlib.ticker import LogLocator

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if axis.get_scale() == "log" and low > 0.0 and math.log10(high / low) > MOST_DECADES:
            axis.set_major_locator(LogLocator(subs=(1.0,)))


def _panels(
    results: Results, drawing: Drawing, where: str | None
) -> list[tuple[str, Mapping[str, Sequence[tuple[float, ...]]], int]]:
    """Return for each panel its title, its lines, as points (x, y, half widths), and the most runs of a point."""
    shown = (*drawing.panel, *drawing.line)
    others = (drawing.x,) if drawing.x in results.settings else drawing.by
    by = tuple(dict.fromkeys([*shown, *others]))
    found = summary(
        results, by, tuple(dict.fromkeys([drawing.x, drawing.y])), quantiles=(), deviations=True, where=where
    )
    panels: dict[str, dict[str, list[tuple[float, ...]]]] = {}
    runs: dict[str, int] = {}
    for row in found.rows:
        named = dict(zip(found.columns, row, strict=True))
        x, y = named[f"{drawing.x}_mean"], named[f"{drawing.y}_mean"]
        if x is not None and y is not None:
            panel = "\n".join(_values(drawing.panel, named))  # two settings do not fit above a panel on one line
            line = ", ".join(_values(drawing.line, named))
            half_widths = (_half_width(named[f"{name}_sd"], named["runs"]) for name in (drawing.x, drawing.y))
            panels.setdefault(panel, {}).setdefault(line, []).append((x, y, *half_widths))
            runs[panel] = max(runs.get(panel, 0), named["runs"])
    if not panels:
        raise SettingsError("there is nothing to draw: no run without error meets the condition")
    return [
        (title, {line: sorted(points) for line, points in lines.items()}, runs[title])
        for title, lines in panels.items()
    ]


def _half_width(deviation: float | None, runs: int) -> float:
    """Return half of the interval of Student's t around a mean; 0 of a single run."""
    return 0.0 if deviation is None or runs < 2 else t_quantile(runs - 1) * deviation / math.sqrt(runs)


def _values(names: Sequence[str], row: Mapping[str, Any]) -> list[str]:
    """Return the value of each setting with what the setting is called and its unit."""
    return [_value(LABELS.get(name, name), row[name]) for name in names]


def _value(label: str, value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    name, _, unit = label.partition(" [")
    return f"{name} {value:g} {unit.removesuffix(']')}".rstrip()
