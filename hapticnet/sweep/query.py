"""Tables of a study's results: mean and quantiles of measures for groups of runs. DuckDB reads the shards."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from hapticnet.checks import check_parameter
from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.sweep.folder import SHARDS, Folder
from hapticnet.sweep.study import Shown
from hapticnet.sweep.table import NEEDS

QUANTILES: Final = (0.05, 0.5, 0.95)
DEFAULT_MEASURES: Final = {
    "felt": ("packets_per_s", "felt_rmse_n", "felt_exceed_jnd"),
    "ordering": ("correct", "bytes_per_penetration"),
}
NOT_VARIED: Final = ("run", "repeat", "error")


@dataclass(frozen=True, slots=True)
class Results:
    """The results in a folder.

    Attributes
    ----------
    about
        What the folder says of itself; see `folder.Folder.about`.
    varied
        Settings with more than one value.
    """

    folder: Folder
    about: dict[str, Any]
    varied: tuple[str, ...]

    @property
    def settings(self) -> tuple[str, ...]:
        """Columns that tell runs apart."""
        return tuple(name for name in self.about["columns"] if name not in (*self.about["measures"], "error"))

    @property
    def numbers(self) -> tuple[str, ...]:
        """Columns of which there is a mean."""
        return tuple(name for name, kind in self.about["columns"].items() if kind != "text")


@dataclass(frozen=True, slots=True)
class Summary:
    """A table.

    Attributes
    ----------
    by, of
        Columns of the groups, and the measures.
    quantiles
        Which quantiles were computed.
    deviations
        Whether standard deviations were.
    rows
        For each group its values, the number of runs, and for each measure the mean, the quantiles and the deviation.
    """

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


def open_results(folder: Folder) -> Results:
    """Return the results in a folder.

    Raises
    ------
    FileError
        If it is not the folder of a study, a shard in it is damaged or another study's, or nothing is there yet.
    UnavailableError
        If DuckDB is not installed.
    """
    about = folder.about()
    if not folder.shards(about["study"]):
        raise FileError(f"{folder.path}: no shard is finished yet")
    others = (*about["measures"], *NOT_VARIED)
    settings = [name for name in about["columns"] if name not in others]
    counts = _rows(folder, "SELECT " + ", ".join(f"count(DISTINCT {_quoted(name)})" for name in settings))[0]
    varied = tuple(name for name, count in zip(settings, counts, strict=True) if count > 1)
    return Results(folder, about, varied)


def chosen(
    results: Results, shown: Shown, by: Sequence[str] | None, of: Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the groups and measures that are asked for, by the study, or that are usual.

    Raises
    ------
    SettingsError
        If there is no such column.
    """
    groups = tuple(by or shown.by or _usual(results))
    measures = tuple(of or shown.of or DEFAULT_MEASURES.get(results.about["task"], results.about["measures"][:3]))
    for name in groups:
        if name not in results.settings:
            raise SettingsError(f"--by: there is no setting {name!r}; there are: {', '.join(results.settings)}")
    for name in measures:
        if name not in results.numbers:
            raise SettingsError(f"--of: there is no measure {name!r}; there are: {', '.join(results.numbers)}")
    return groups, measures


def summary(
    results: Results,
    by: Sequence[str],
    of: Sequence[str],
    *,
    quantiles: Sequence[float] = QUANTILES,
    deviations: bool = False,
    where: str | None = None,
) -> Summary:
    """Return mean and quantiles of measures for each group. Runs with errors are left out.

    Parameters
    ----------
    deviations
        Whether to add the standard deviation over the runs of a group; None of a single run.
    where
        A condition on rows, in SQL.

    Raises
    ------
    SettingsError
        If a quantile is out of range, or DuckDB does not understand the condition.
    FileError
        If a shard cannot be read.
    """
    for each in quantiles:
        check_parameter("quantile", each, 0.0, 1.0)
    groups = [_quoted(name) for name in by]
    parts = [*groups, "count(*)"]
    for name in map(_quoted, of):
        parts += [f"avg({name})", *(f"quantile_cont({name}::DOUBLE, {each!r})" for each in quantiles)]
        parts += [f"stddev_samp({name})"] if deviations else []
    condition = f" WHERE error IS NULL AND ({where})" if where else " WHERE error IS NULL"
    grouped = f" GROUP BY {', '.join(groups)} ORDER BY {', '.join(groups)}" if groups else ""
    rows = _rows(results.folder, f"SELECT {', '.join(parts)}", condition + grouped)
    return Summary(tuple(by), tuple(of), tuple(quantiles), deviations, rows)


def _usual(results: Results) -> tuple[str, ...]:
    """Return what varies, without what says the same in other words."""
    varied = list(results.varied)
    for short, longs in (
        ("codec", ("label",)),
        ("delay_ms", ("forward", "feedback")),
        ("loss", ("forward", "feedback")),
    ):
        if short in varied:
            varied = [name for name in varied if name not in longs]
    return tuple(varied)


def _rows(folder: Folder, select: str, rest: str = "") -> list[tuple[Any, ...]]:
    try:
        import duckdb
    except ImportError as error:
        raise UnavailableError(NEEDS) from error
    source = str(folder.path / SHARDS).replace("'", "''")
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
        raise FileError(f"{folder.path}: {_first_line(error)}") from error
    return rows


def _quoted(name: str) -> str:
    escaped = name.replace('"', '""')
    return f'"{escaped}"'


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
