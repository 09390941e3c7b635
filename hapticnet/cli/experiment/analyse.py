"""``hapticnet experiment analyse``: tables, figures and a report of a study."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final

import typer

from hapticnet import options

FILES: Final = ("report.md", "conditions.csv", "conditions.tex", "results.json")


def analyse(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the study.")],
    out_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of results; default: DIR/results.")
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option(help="Margin of equivalence, in the share of correct orders; default: that stated in the plan."),
    ] = None,
    seed: options.Seed = 1,
    plots: Annotated[bool, typer.Option(help="Draw plots as PDF and PNG.")] = True,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Analyse the study: report.md, tables as CSV and LaTeX, plots as PDF and PNG.

    The plot correct-orders is the paper's Fig. 5, bytes-per-penetration its Fig. 4.
    """
    from hapticnet.cli.console import Console, check_new, show

    console = Console("experiment", quiet=json)
    target = folder / "results" if out_dir is None else out_dir
    check_new(*(target / name for name in FILES), overwrite=overwrite)
    report, account = write_results(folder, target, margin=margin, seed=seed, plots=plots, say=console.say)
    if plots:
        _draw_series(folder, target, console.say)
    show(account if json else report.removesuffix("\n"))


def _draw_series(folder: Path, target: Path, say: Callable[[str], None]) -> None:
    """Draw how each participant answered in the measurement of the JND."""
    from hapticnet.errors import UnavailableError
    from hapticnet.study.reading import read_rows
    from hapticnet.study.rows import LimitsRow
    from hapticnet.study.series_figure import draw_series

    try:
        files = draw_series(read_rows(folder, LimitsRow), target)
    except UnavailableError:  # the missing matplotlib was told with the other plots
        return
    if files:
        say(f"{len(files)} pictures of the series of JNDs: {target}")


def write_results(
    folder: Path, target: Path, *, margin: float | None, seed: int, plots: bool, say: Callable[[str], None]
) -> tuple[str, str]:
    """Analyse a study, write its results to a folder, and return the report and the account as JSON.

    Parameters
    ----------
    margin
        Margin of equivalence; None for that of the study's plan.
    say
        Called with lines for the experimenter.

    Raises
    ------
    SettingsError
        If there is nothing to analyse.
    FileError
        If a table cannot be read or a result cannot be written.
    """
    import json as json_module
    from dataclasses import asdict

    from hapticnet.cli.console import check_outputs, write_text
    from hapticnet.errors import UnavailableError, visible
    from hapticnet.experiment.provenance import provenance, provenance_lines
    from hapticnet.study.analysis import analyse as analyse_rows
    from hapticnet.study.checking import accepted
    from hapticnet.study.figures import draw_results
    from hapticnet.study.models import fit_models
    from hapticnet.study.reading import read_people, read_rows
    from hapticnet.study.report import jnd_markdown, markdown
    from hapticnet.study.rows import OrderRow
    from hapticnet.study.tables import csv_text, latex

    rows = read_rows(folder, OrderRow)
    people = read_people(folder)
    if people and not accepted(rows):
        origin = provenance_lines()
        report = jnd_markdown(people, title=f"Results of {visible(folder.resolve().name)}", origin=origin)
        jnds = {"provenance": provenance(), "jnds": [each.model_dump() for each in people]}
        text = json_module.dumps(plain(jnds), indent=1)
        check_outputs(*(target / name for name in ("report.md", "results.json")))
        write_text(target / "report.md", report, follow=False)
        write_text(target / "results.json", text + "\n", follow=False)
        say(f"report: {target}")
        return report, text
    used, stated = _margin(folder, margin)
    results = analyse_rows(rows, margin=used, seed=seed)
    check_outputs(*(target / name for name in FILES))
    note, effects = None, []
    try:
        effects = fit_models(accepted(rows), [each.name for each in results.conditions])
    except UnavailableError as error:
        note = str(error)
    pictures: list[Path] = []
    if plots:
        try:
            pictures = draw_results(results, target)
        except UnavailableError as error:
            say(str(error))
    origin = provenance_lines()
    report = markdown(
        results,
        title=f"Results of {visible(folder.resolve().name)}",
        figures=[file.name for file in pictures],
        effects=effects,
        models_note=note,
        people=people,
        origin=origin,
        stated=stated,
    )
    account = {
        "provenance": provenance(),
        "margin_stated": stated,
        "results": asdict(results),
        "models": [asdict(each) for each in effects],
    }
    text = json_module.dumps(plain(account), indent=1)
    contents = report, csv_text(results, origin), latex(results, origin), text + "\n"
    for name, content in zip(FILES, contents, strict=True):
        write_text(target / name, content, follow=False)
    say(f"report, tables and {len(pictures)} pictures: {target}")
    return report, text


def _margin(folder: Path, given: float | None) -> tuple[float, str]:
    """Return the margin of equivalence, and where it was stated."""
    from hapticnet.checks import check_parameter
    from hapticnet.study.plan import PLAN_FILE, find_plan
    from hapticnet.study.results import MARGIN

    planned = find_plan(str(folder / PLAN_FILE)).order.equivalence_margin if (folder / PLAN_FILE).exists() else None
    if given is not None:
        check_parameter("--margin", given, 0.001, 1.0)
    if given is None or given == planned:
        return (MARGIN, "a default, since there is no plan") if planned is None else (planned, "stated in the plan")
    where = f"; the plan stated ±{100 * planned:g}" if planned is not None else ""
    return given, f"given at the analysis, not beforehand{where}"


def plain(value: object) -> object:
    """Return a value with null for every number that JSON does not have."""
    import math

    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
