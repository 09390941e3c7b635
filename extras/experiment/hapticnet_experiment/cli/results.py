"""``hapticnet experiment`` without a participant: analyse data, print texts."""

import json as json_module
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final

import typer

from hapticnet import options

FILES: Final = ("report.md", "results.json")


def analyse(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the study.")],
    out_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of results; default: DIR/results.")
    ] = None,
    plots: Annotated[bool, typer.Option(help="Draw plots as PDF and PNG.")] = True,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Analyse the study: report.md, figures as JSON, plots as PDF and PNG.

    The plot correct-orders is the paper's Fig. 5, bytes-per-penetration its Fig. 4. The margin of equivalence is the
    plan's, since it must be stated before the study.
    """
    from hapticnet.cli.console import Console, check_new, show

    console = Console("experiment", quiet=json)
    target = folder / "results" if out_dir is None else out_dir
    check_new(*(target / name for name in FILES), overwrite=overwrite)
    report, account = write_results(folder, target, plots=plots, say=console.say)
    show(account if json else report.removesuffix("\n"))


def write_results(folder: Path, target: Path, *, plots: bool, say: Callable[[str], None]) -> tuple[str, str]:
    """Analyse a study, write its results to a folder, and return the report and the account as JSON.

    `say` is called with lines for the experimenter. Raises SettingsError if there is nothing to analyse, and FileError
    if a table cannot be read or a result cannot be written.
    """
    from dataclasses import asdict

    from hapticnet.cli.console import check_outputs, write_text
    from hapticnet.errors import visible
    from hapticnet.experiment.provenance import provenance, provenance_lines
    from hapticnet_experiment.analysis import MARGIN, accepted
    from hapticnet_experiment.analysis import analyse as analyse_rows
    from hapticnet_experiment.figures import draw_results
    from hapticnet_experiment.plan import PLAN_FILE, find_plan
    from hapticnet_experiment.report import markdown
    from hapticnet_experiment.rows import OrderRow
    from hapticnet_experiment.store import read_people, read_rows

    rows = read_rows(folder, OrderRow)
    people = read_people(folder)
    title, origin = f"Results of {visible(folder.resolve().name)}", provenance_lines()
    pictures: list[Path] = []
    files = [target / name for name in FILES]
    if people and not accepted(rows):
        check_outputs(*files)
        report = markdown(None, title=title, people=people, origin=origin)
        account = {"provenance": provenance(), "jnds": [each.model_dump() for each in people]}
    else:
        margin, stated = MARGIN, "the default, because there is no plan"
        if (folder / PLAN_FILE).exists():
            margin, stated = find_plan(str(folder / PLAN_FILE)).order.equivalence_margin, "stated in the plan"
        results = analyse_rows(rows, margin=margin)
        check_outputs(*files)
        if plots:
            pictures = draw_results(results, target)
        names = [file.name for file in pictures]
        report = markdown(results, title=title, figures=names, people=people, origin=origin, stated=stated)
        account = {"provenance": provenance(), "margin_stated": stated, "results": asdict(results)}
    text = json_module.dumps(_plain(account), indent=1)
    for file, content in zip(files, (report, text + "\n"), strict=True):
        write_text(file, content, follow=False)
    say(f"report, figures and {len(pictures)} pictures: {target}")
    return report, text


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def texts() -> None:
    """Print what participants read, consent and instructions included, as a file to change or translate.

    Name the changed file in the plan: texts = "my-texts.toml".
    """
    from hapticnet_experiment.screens import shipped

    print(shipped(), end="")
