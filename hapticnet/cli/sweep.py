"""``hapticnet sweep``: compute the missing runs of a study and show the progress; tables and figures of results."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.core import TyperGroup

from hapticnet import options
from hapticnet.cli.console import Console

if TYPE_CHECKING:
    from hapticnet.sweep.engine import Progress
    from hapticnet.sweep.plan import Plan
    from hapticnet.sweep.pools import AnyPool
    from hapticnet.sweep.results import Results, Summary

ACCOUNT: Final = (
    "runs", "done", "computed", "failed", "first_error", "shards", "lost_workers", "poison", "seconds", "runs_per_s",
    "worker_seconds", "worker_cpu_seconds",
)  # fmt: skip
"""Parts of the progress that the final report has."""

LINE_S: Final = 30.0
"""Time [s] between two lines where there is no terminal."""

RUN: Final = "run"
HELP: Final = ("-h", "--help")


class WithoutVerb(TyperGroup):
    """Reads ``sweep STUDY.toml`` as ``sweep run STUDY.toml``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Add the verb if it is omitted."""
        if args and args[0] not in self.commands and args[0] not in HELP:
            args = [RUN, *args]
        return super().parse_args(ctx, args)


def run(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="The study: a TOML file, see docs/use/compare.md.")],
    out_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results. Existing results are kept.")
    ] = None,
    jobs: options.Jobs = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT", help="Use the workers of this Dask scheduler; needs the extra cluster."
        ),
    ] = None,
    repeats: Annotated[
        int | None, typer.Option(metavar="N", help="Repeats, instead of the study's number; more can be added later.")
    ] = None,
    shard: Annotated[
        int | None, typer.Option(metavar="N", help="Runs in each file of results; default: as many as take about 3 s.")
    ] = None,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Compute the missing runs of a study and store them in DIR.

    The numbers do not depend on --jobs and --shard. Ctrl-C finishes the shards under way; run the same command
    again to continue.
    """
    from hapticnet.checks import check_integer
    from hapticnet.cli.console import check_outputs, deliver
    from hapticnet.errors import SettingsError, UnavailableError
    from hapticnet.experiment.provenance import provenance
    from hapticnet.sweep import engine
    from hapticnet.sweep.plan import plan_of
    from hapticnet.sweep.store import Store, arrow
    from hapticnet.sweep.study import read_study

    if jobs is not None and scheduler is not None:
        raise SettingsError("--jobs starts processes here, and --scheduler has its own workers; give one of them")
    if shard is not None:
        check_integer("--shard", shard, 1, 10**9)
    arrow()
    file = read_study(study)
    plan = plan_of(file, repeats)
    check_outputs(report, inputs=[study])
    cores = len(os.sched_getaffinity(0)) if jobs is None else jobs
    if out_dir is None:
        raise SettingsError("--out-dir DIR is missing: the folder of the results")
    store = Store(out_dir)
    with store.held():
        there = store.open(plan, file.text, {"provenance": provenance()})
        console = Console("sweep", quiet=quiet or json)
        with _stopped_by_signals() as taken, _shown(plan.name, console, quiet=quiet or json) as show:
            pool = _pool(plan, cores, scheduler)
            try:
                progress = engine.sweep(
                    plan,
                    store,
                    there,
                    pool,
                    sizes=engine.Sizes(shard),
                    is_stopped=lambda: bool(taken),
                    on_progress=show,
                )
            finally:
                pool.close()
        if progress.failed:
            console.warn(
                f"{progress.failed:,} runs have an error instead of figures, the first: {progress.first_error}"
            )
        if progress.stopped:
            console.say(f"stopped with {progress.done:,} of {progress.runs:,} runs; the same command continues")
        account = {key: getattr(progress, key) for key in ACCOUNT}
        account["poison"] = [f"{shard.first}-{shard.end}" for shard in progress.poison]
        about = {"study": plan.name, "digest": plan.digest, "folder": str(out_dir)}
        deliver({**about, **account, "complete": progress.done == progress.runs}, as_json=json, file=report)
    if progress.stopped and taken:
        raise typer.Exit(128 + taken[0])
    if progress.poison:
        raise UnavailableError(
            f"{len(progress.poison)} shards could not be computed, the first because {progress.first_reason}; run the"
            " same command again to try them again"
        )


def _pool(plan: "Plan", jobs: int, scheduler: str | None) -> "AnyPool":
    from hapticnet.sweep.pools import ClusterPool, local_pool

    return local_pool(plan, jobs) if scheduler is None else ClusterPool(plan, scheduler)


@contextmanager
def _stopped_by_signals() -> Iterator[list[int]]:
    """Yield the received signals: the first SIGINT or SIGTERM stops the sweep, the second ends it at once."""
    taken: list[int] = []

    def take(number: int, _frame: FrameType | None) -> None:
        if taken:
            raise KeyboardInterrupt
        taken.append(number)

    if threading.current_thread() is not threading.main_thread():  # other threads cannot receive them
        yield taken
        return
    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield taken
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _shown(name: str, console: Console, *, quiet: bool) -> "Iterator[Callable[[Progress], None]]":
    """Yield the progress display of a study: a bar on a terminal, a line now and then elsewhere."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        said_s = 0.0

        def say(progress: "Progress") -> None:
            nonlocal said_s
            if progress.seconds - said_s >= LINE_S:
                said_s = progress.seconds
                console.say(f"{progress.done:,} of {progress.runs:,} runs, {_state(progress)}")

        yield say
        return
    from rich.console import Console as Terminal
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(bar_width=20), MofNCompleteColumn(), TextColumn("{task.fields[state]}"))
    with Bar(*columns, console=Terminal(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=None, state="")
        yield lambda progress: bar.update(task, total=progress.runs, completed=progress.done, state=_state(progress))


def _state(progress: "Progress") -> str:
    if progress.stopped:
        return "finishing the current shards"
    parts = [f"{progress.runs_per_s:.3g} runs/s", f"{progress.workers} workers"]
    if progress.left_s is not None:
        parts.append(f"{_time(progress.left_s)} left")
    if progress.failed:
        parts.append(f"{progress.failed:,} failed")
    if progress.lost_workers:
        parts.append(f"{progress.lost_workers} workers lost")
    return ", ".join(parts)


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a sweep, finished or not.")],
    by: Annotated[
        str | None, typer.Option(metavar="COLUMN[,COLUMN…]", help="Settings that make groups; default: the study's.")
    ] = None,
    of: Annotated[
        str | None, typer.Option(metavar="COLUMN[,COLUMN…]", help="Measures to show; default: the study's.")
    ] = None,
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
    from hapticnet.experiment.table import csv_text
    from hapticnet.sweep.results import chosen, draw, open_results, summary
    from hapticnet.sweep.store import STUDY, Store
    from hapticnet.sweep.study import read_study

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
    found = summary(results, groups, measures, where=shown.where)
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
    from hapticnet.cli.console import show as print_text
    from hapticnet.experiment.table import print_table

    span = [f"{100 * each:g}" for each in (found.quantiles[:1] + found.quantiles[-1:])]
    below = f"\n({'–'.join(span)} %)" if span else ""
    start, each = len(found.by) + 1, 1 + len(found.quantiles)
    rows = [
        [*map(_text, row[:start]), *(_mean_and_span(row[at : at + each]) for at in range(start, len(row), each))]
        for row in found.rows
    ]
    runs = sum(row[len(found.by)] for row in found.rows)
    print_text(f"{results.about['name']}: {runs:,} of {results.about['runs']:,} runs")
    print_table([*found.by, "runs", *(f"{name}, mean{below}" for name in found.of)], rows, left=len(found.by))


def _mean_and_span(values: tuple[Any, ...]) -> str:
    mean, *quantiles = map(_text, values)
    return f"{mean} ({quantiles[0]}–{quantiles[-1]})" if quantiles else mean


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


app = typer.Typer(
    cls=WithoutVerb,
    no_args_is_help=True,
    help="Compute every combination of the settings in a study, with all cores or a cluster.\n\n"
    "'hapticnet sweep STUDY.toml' is short for 'hapticnet sweep run STUDY.toml'.",
)
app.command(RUN, short_help="Compute the missing runs of a study.")(run)
app.command("show", short_help="Print a table of the results, or draw a figure.")(show)
