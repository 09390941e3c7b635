"""The results of a study, read by DuckDB, as a table and a figure: mean and quantiles for groups of runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.experiment.style import LOG_MARK, PRINT_WIDTH_IN, check_format, draw_codecs, finish_axes, legend, picture
from hapticnet.experiment.summary import t_quantile
from hapticnet.sweep.store import NEEDS, SHARDS, Store
from hapticnet.sweep.study import Shown

QUANTILES: Final = (0.05, 0.5, 0.95)
DEFAULT_MEASURES: Final = ("packets_per_s", "felt_rmse_n", "felt_exceed_jnd")
NOT_VARIED: Final = ("run", "repeat", "error")


LABELS: Final = {
    "packets_per_s": "packets/s",
    "wire_bytes_per_s": "B/s with headers",
    "felt_rmse_n": "RMS error of the felt force [N]",
    "felt_max_error_n": "largest error of the felt force [N]",
    "felt_exceed_jnd": "share of time above 1 JND",
    "felt_above_2_jnd": "share of time above 2 JND",
    "felt_above_4_jnd": "share of time above 4 JND",
    "felt_above_8_jnd": "share of time above 8 JND",
    "felt_p99_error_n": "99th percentile of the error of the felt force [N]",
    "felt_rms_jnd": "RMS distance of the felt force [JND]",
    "coded_rmse_n": "RMS error of the codec [N]",
    "multiplier": "threshold [JND]",
    "delay_ms": "delay of each way [ms]",
    "jitter_ms": "jitter [ms]",
    "loss": "share lost",
    "rate_hz": "positions/s",
}
MOST_PANELS: Final = 12
PANEL_HEIGHT_IN: Final = 2.3
ACROSS: Final = 3  # panels in a row, at most
MOST_DECADES: Final = 2.5  # decades up to which an axis of a panel has labels within a decade


@dataclass(frozen=True, slots=True)
class Results:
    """The results in a folder."""

    store: Store
    about: dict[str, Any]  # the folder's description; see `Store.about`
    varied: tuple[str, ...]  # settings with more than one value

    @property
    def settings(self) -> tuple[str, ...]:
        """Columns that distinguish runs."""
        return tuple(name for name in self.about["columns"] if name not in (*self.about["measures"], "error"))

    @property
    def numbers(self) -> tuple[str, ...]:
        """Columns that have a mean."""
        return tuple(name for name, kind in self.about["columns"].items() if kind != "text")


@dataclass(frozen=True, slots=True)
class Summary:
    """For groups of runs by the settings `by`: their number, and mean, quantiles and deviation of the measures `of`."""

    by: tuple[str, ...]
    of: tuple[str, ...]
    quantiles: tuple[float, ...]
    deviations: bool
    rows: list[tuple[Any, ...]]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns."""
        marks = ["mean", *(f"q{100 * each:g}" for each in self.quantiles), *(["sd"] if self.deviations else [])]
        return (*self.by, "runs", *(f"{name}_{mark}" for name in self.of for mark in marks))


def open_results(store: Store) -> Results:
    """Return the results in a folder; FileError if it has none, or a shard is damaged or another study's."""
    about = store.about()
    if not store.shards(about["study"]):
        raise FileError(f"{store.path}: no shard is finished yet")
    others = (*about["measures"], *NOT_VARIED)
    settings = [name for name in about["columns"] if name not in others]
    counts = _rows(store, "SELECT " + ", ".join(f"count(DISTINCT {_quoted(name)})" for name in settings))[0]
    varied = tuple(name for name, count in zip(settings, counts, strict=True) if count > 1)
    return Results(store, about, varied)


def chosen(results: Results, shown: Shown) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the groups and measures from the options, the study, or the defaults; SettingsError if unknown."""
    groups = tuple(shown.by or _usual(results))
    measures = tuple(shown.of or DEFAULT_MEASURES)
    _check_known("--by", "setting", groups, results.settings)
    _check_known("--of", "measure", measures, results.numbers)
    return groups, measures


def _check_known(option: str, what: str, names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise SettingsError(f"{option}: there is no {what} {name!r}; there are: {', '.join(known)}")


def summary(
    results: Results,
    by: Sequence[str],
    of: Sequence[str],
    *,
    quantiles: Sequence[float] = QUANTILES,
    deviations: bool = False,
    where: str | None = None,
) -> Summary:
    """Return mean and quantiles of measures for each group, with `deviations` also the standard deviation.

    Runs with errors are omitted; `where` is a condition in SQL. Raise SettingsError for either, FileError for a shard.
    """
    groups = [_quoted(name) for name in by]
    parts = [*groups, "count(*)"]
    for name in map(_quoted, of):
        parts += [f"avg({name})", *(f"quantile_cont({name}::DOUBLE, {each!r})" for each in quantiles)]
        parts += [f"stddev_samp({name})"] if deviations else []
    condition = f" WHERE error IS NULL AND ({where})" if where else " WHERE error IS NULL"
    grouped = f" GROUP BY {', '.join(groups)} ORDER BY {', '.join(groups)}" if groups else ""
    rows = _rows(results.store, f"SELECT {', '.join(parts)}", condition + grouped)
    return Summary(tuple(by), tuple(of), tuple(quantiles), deviations, rows)


def _usual(results: Results) -> tuple[str, ...]:
    """Return the varying settings, without redundant ones."""
    varied = list(results.varied)
    channels = ("forward", "feedback")
    for short, longs in (("codec", ("label",)), ("delay_ms", channels), ("loss", channels)):
        if short in varied:
            varied = [name for name in varied if name not in longs]
    return tuple(varied)


def _rows(store: Store, select: str, rest: str = "") -> list[tuple[Any, ...]]:
    try:
        import duckdb
    except ImportError as error:
        raise UnavailableError(NEEDS) from error
    source = str(store.path / SHARDS).replace("'", "''")
    try:
        with duckdb.connect() as connection:
            # Sums of floats depend on their order: a single thread gives the same table each time.
            connection.execute("SET threads = 1")
            rows: list[tuple[Any, ...]] = connection.execute(
                f"{select} FROM (SELECT * FROM read_parquet('{source}') ORDER BY run){rest}"  # noqa: S608 - own data
            ).fetchall()
    except (duckdb.BinderException, duckdb.ParserException, duckdb.ConversionException) as error:
        raise SettingsError(f"DuckDB does not understand the condition: {_first_line(error)}") from error
    except duckdb.Error as error:
        raise FileError(f"{store.path}: {_first_line(error)}") from error
    return rows


def _quoted(name: str) -> str:
    escaped = name.replace('"', '""')
    return f'"{escaped}"'


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


def draw(results: Results, shown: Shown, by: Sequence[str], file: Path) -> None:
    """Draw the means of groups of runs into a file; SettingsError for an unknown column or too many panels.

    If `shown.x` is a measure, a line has a point for each combination of values of `by`, else for each of its values.
    """
    check_format(file.suffix[1:])
    x, y, line, panel = shown.x, shown.y, tuple(shown.line or ()), tuple(shown.panel or ())
    if x is None or y is None:
        raise SettingsError("--plot needs --x and --y, because the study's [show] does not name them")
    _check_known("--x", "column of numbers", [x], results.numbers)
    _check_known("--y", "column of numbers", [y], results.numbers)
    _check_known("--line", "setting", line, results.settings)
    _check_known("--panel", "setting", panel, results.settings)
    groups = dict.fromkeys([*panel, *line, *([x] if x in results.settings else by)])
    measures = tuple(dict.fromkeys([x, y]))
    found = summary(results, tuple(groups), measures, quantiles=(), deviations=True, where=shown.where)
    panels = _panels(found, x, y, line, panel)
    if len(panels) > MOST_PANELS:
        raise SettingsError(f"--panel {','.join(panel)} makes {len(panels)} panels; at most {MOST_PANELS} are drawn")
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
        drawn = [axes for axes in grid.flat if axes.get_visible()]
        finish_axes(*drawn, across="log" if x.endswith("_per_s") else "linear")
        for axes in drawn:
            _thin_out(axes)
        for axes in grid[-1]:
            axes.set_xlabel(LABELS.get(x, x))
        told = LABELS.get(y, y) + (LOG_MARK if grid.flat[0].get_yscale() == "log" else "")
        figure.supylabel(told, fontsize="medium")  # once, because the panels share the axis
        if line:
            legend(figure, *drawn)


def _thin_out(axes: Any) -> None:
    """Label decades only where an axis spans many of them."""
    from matplotlib.ticker import LogLocator

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if axis.get_scale() == "log" and low > 0.0 and math.log10(high / low) > MOST_DECADES:
            axis.set_major_locator(LogLocator(subs=(1.0,)))


def _panels(
    found: Summary, x: str, y: str, line: Sequence[str], panel: Sequence[str]
) -> list[tuple[str, Mapping[str, Sequence[tuple[float, ...]]], int]]:
    """Return for each panel its title, its lines, as points (x, y, half widths), and the most runs per point."""
    panels: dict[str, dict[str, list[tuple[float, ...]]]] = {}
    runs: dict[str, int] = {}
    for row in found.rows:
        named = dict(zip(found.columns, row, strict=True))
        across, up = named[f"{x}_mean"], named[f"{y}_mean"]
        if across is not None and up is not None:
            title = "\n".join(_values_of(panel, named))  # two settings do not fit above a panel on one line
            half_widths = (_half_width(named[f"{name}_sd"], named["runs"]) for name in (x, y))
            lines = panels.setdefault(title, {})
            lines.setdefault(", ".join(_values_of(line, named)), []).append((across, up, *half_widths))
            runs[title] = max(runs.get(title, 0), named["runs"])
    if not panels:
        raise SettingsError("there is nothing to draw: no run without error meets the condition")
    return [
        (title, {line: sorted(points) for line, points in lines.items()}, runs[title])
        for title, lines in panels.items()
    ]


def _half_width(deviation: float | None, runs: int) -> float:
    """Return half of the interval of Student's t around a mean; 0 for a single run."""
    return 0.0 if deviation is None or runs < 2 else t_quantile(runs - 1) * deviation / math.sqrt(runs)


def _values_of(names: Sequence[str], row: Mapping[str, Any]) -> list[str]:
    return [_value(LABELS.get(name, name), row[name]) for name in names]


def _value(label: str, value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    name, _, unit = label.partition(" [")
    return f"{name} {value:g} {unit.removesuffix(']')}".rstrip()
