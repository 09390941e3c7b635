"""``hapticnet sweep show``: tables and figures of a study's results."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.sweep.results import Results, Summary


def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a sweep, finished or not.")],
    by: Annotated[
        str | None, typer.Option(metavar="COLUMN[,COLUMN…]", help="Settings that make groups; default: the study's.")
    ] = None,
    of: Annotated[
        str | None, typer.Option(metavar="COLUMN[,COLUMN…]", help="Measures to show; default: the study's.")
    ] = None,
    quantiles: Annotated[str, typer.Option(metavar="Q[,Q…]", help="Quantiles beside the mean.")] = "0.05,0.5,0.95",
    where: Annotated[
        str | None, typer.Option(metavar="SQL", help="Only these rows, such as \"codec = 'deadband' AND loss > 0\".")
    ] = None,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the table to FILE as CSV.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw a figure: .png, .pdf or .svg.")] = None,
    x: Annotated[str | None, typer.Option(metavar="COLUMN", help="Column for the horizontal axis.")] = None,
    y: Annotated[str | None, typer.Option(metavar="COLUMN", help="Column for the vertical axis.")] = None,
    line: Annotated[
        str | None, typer.Option(metavar="COLUMN[,COLUMN…]", help="Settings with a line for each value.")
    ] = None,
    panel: Annotated[
        str | None, typer.Option(metavar="COLUMN[,COLUMN…]", help="Settings with a panel for each value.")
    ] = None,
    json: options.Json = False,
    overwrite: options.Overwrite = False,
) -> None:
    """Print mean and quantiles of the results for each group of runs, or draw them."""
    from hapticnet.cli.console import Console, check_needed, check_new, check_outputs, write_text
    from hapticnet.errors import SettingsError
    from hapticnet.experiment.table import csv_text
    from hapticnet.sweep.results import chosen, draw, open_results, summary
    from hapticnet.sweep.store import STUDY, Store
    from hapticnet.sweep.study import read_study

    try:
        shares = [float(part) for part in quantiles.split(",") if part]
    except ValueError:
        raise SettingsError(f"--quantiles {quantiles!r} must be numbers from 0 to 1, such as 0.05,0.5,0.95") from None
    check_needed("--plot", plot, {"--x": x, "--y": y, "--line": line, "--panel": panel})
    results = open_results(Store(folder))
    given = {"by": by, "of": of, "line": line, "panel": panel}
    asked: dict[str, Any] = {
        key: [each.strip() for each in names.split(",") if each.strip()]
        for key, names in given.items()
        if names is not None
    }
    asked |= {key: text for key, text in (("where", where), ("x", x), ("y", y)) if text}
    shown = read_study(folder / STUDY).study.show.model_copy(update=asked)
    check_outputs(csv, plot)
    check_new(csv, plot, overwrite=overwrite)
    groups, measures = chosen(results, shown)
    found = summary(results, groups, measures, quantiles=shares, where=shown.where)
    console = Console("sweep", quiet=json)
    if csv is not None:
        write_text(csv, csv_text(found.columns, found.rows))
        console.say(f"table: {csv}")
    if plot is not None:
        draw(results, shown, groups, plot)
        console.say(f"picture: {plot}")
    if json:
        _print_json(results, found)
    elif csv is None and plot is None:
        _print_table(results, found)


def _print_json(results: "Results", found: "Summary") -> None:
    import json

    from hapticnet.experiment.provenance import provenance

    rows: list[dict[str, Any]] = [dict(zip(found.columns, row, strict=True)) for row in found.rows]
    about = {key: results.about[key] for key in ("name", "study", "runs", "versions")}
    print(json.dumps({**about, "rows": rows, "provenance": provenance()}, indent=2))


def _print_table(results: "Results", found: "Summary") -> None:
    from hapticnet.cli.console import show
    from hapticnet.experiment.table import print_table

    span = [f"{100 * each:g}" for each in (found.quantiles[:1] + found.quantiles[-1:])]
    below = f"\n({'–'.join(span)} %)" if span else ""
    start, each = len(found.by) + 1, 1 + len(found.quantiles)
    rows = [
        [*map(_text, row[:start]), *(_mean_and_span(row[at : at + each]) for at in range(start, len(row), each))]
        for row in found.rows
    ]
    runs = sum(row[len(found.by)] for row in found.rows)
    show(f"{results.about['name']}: {runs:,} of {results.about['runs']:,} runs")
    print_table([*found.by, "runs", *(f"{name}, mean{below}" for name in found.of)], rows, left=len(found.by))


def _mean_and_span(values: tuple[Any, ...]) -> str:
    mean, *quantiles = map(_text, values)
    return f"{mean} ({quantiles[0]}–{quantiles[-1]})" if quantiles else mean


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
