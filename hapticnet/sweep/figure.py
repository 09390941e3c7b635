"""A figure of a study's results: a line for each value of one column, a panel for each value of another."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import SettingsError
from hapticnet.experiment.style import PRINT_WIDTH_IN, check_format, draw_codecs, finish_axes, picture
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

LOW, HIGH = 0.05, 0.95
"""The quantiles that bars span."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """What to draw.

    Attributes
    ----------
    x, y
        Columns of the axes: settings or measures. Of measures, the mean of each group is drawn.
    line, panel
        Columns with one line, and one panel, for each value; None: one.
    by
        All columns that make groups.
    """

    x: str
    y: str
    line: str | None
    panel: str | None
    by: tuple[str, ...]


def draw(results: Results, drawing: Drawing, file: Path, *, where: str | None = None) -> None:
    """Draw a figure into a file. Bars span 5 to 95 % of the runs.

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
    for option, setting in (("--line", drawing.line), ("--panel", drawing.panel)):
        if setting is not None and setting not in results.settings:
            raise SettingsError(f"{option}: there is no setting {setting!r}; there are: {', '.join(results.settings)}")
    panels = _panels(results, drawing, where)
    if len(panels) > MOST_PANELS:
        raise SettingsError(f"--panel {drawing.panel} has {len(panels)} values; at most {MOST_PANELS} panels are drawn")
    columns = min(ACROSS, len(panels))
    rows = -(-len(panels) // columns)
    with picture(file, 0.9 + PANEL_HEIGHT_IN * rows, width_in=PRINT_WIDTH_IN) as figure:
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, (value, lines) in zip(grid.flat, panels, strict=False):
            draw_codecs(axes, lines)
            if drawing.panel is not None:
                axes.set_title(_value(drawing.panel, value))
        for axes in list(grid.flat)[len(panels) :]:
            axes.set_visible(False)
        _finish(figure, grid, drawing, results.about["name"])


def _finish(figure: Any, grid: Any, drawing: Drawing, name: str) -> None:
    # Errors and rates span decades; shares of answers do not.
    if drawing.y not in ("correct",):
        finish_axes(grid[0, 0], across="log" if drawing.x.endswith("_per_s") else "linear")
    for axes in grid[-1]:
        axes.set_xlabel(LABELS.get(drawing.x, drawing.x))
    for axes in grid[:, 0]:
        axes.set_ylabel(LABELS.get(drawing.y, drawing.y))
    handles: dict[str, Any] = {}
    for axes in grid.flat:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    labels = list(handles)
    if len(labels) > 1 or drawing.line is not None:
        figure.legend(list(handles.values()), labels, loc="outside lower center", ncols=min(4, len(labels)))
    figure.suptitle(name, fontsize=9)


def _panels(
    results: Results, drawing: Drawing, where: str | None
) -> list[tuple[Any, Mapping[str, Sequence[tuple[float, ...]]]]]:
    """Return for each panel its lines, as points (x, y, half widths of their bars)."""
    wanted = [
        name for name in (drawing.panel, drawing.line, drawing.x) if name is not None and name in results.settings
    ]
    by = tuple(dict.fromkeys([*wanted, *drawing.by]))
    of = tuple(dict.fromkeys([drawing.x, drawing.y]))
    found = summary(results, by, of, quantiles=(LOW, HIGH), where=where)
    panels: dict[Any, dict[str, list[tuple[float, ...]]]] = {}
    for row in found.rows:
        named = dict(zip(found.columns, row, strict=True))
        x, y = named[f"{drawing.x}_mean"], named[f"{drawing.y}_mean"]
        if x is None or y is None:
            continue
        panel = named[drawing.panel] if drawing.panel is not None else None
        line = _value(drawing.line, named[drawing.line]) if drawing.line is not None else "all"
        panels.setdefault(panel, {}).setdefault(line, []).append((x, y))
    if not panels:
        raise SettingsError("there is nothing to draw: no run without error meets the condition")
    return [(value, {line: sorted(points) for line, points in lines.items()}) for value, lines in panels.items()]


def _value(name: str, value: Any) -> str:
    if isinstance(value, float):
        return f"{name} {value:g}"
    return str(value)
