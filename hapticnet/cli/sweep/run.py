"""``hapticnet sweep run``: compute the missing runs of a study, and show how far it is."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Final

import typer

from hapticnet import options
from hapticnet.cli.console import Console

if TYPE_CHECKING:
    from hapticnet.sweep.engine import Progress
    from hapticnet.sweep.pools import AnyPool
    from hapticnet.sweep.runs import Plan

ACCOUNT: Final = (
    "runs", "done", "computed", "failed", "first_error", "shards", "lost_workers", "poison", "seconds", "runs_per_s",
    "worker_seconds", "worker_cpu_seconds",
)  # fmt: skip
"""What is reported of the progress at the end."""

LINE_S: Final = 30.0
"""Time [s] between two lines where there is no terminal."""


def run(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="The study: a TOML file, see docs/use/compare.md.")],
    out_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results. What is there already is kept.")
    ] = None,
    jobs: options.Jobs = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT", help="Use the workers of this Dask scheduler; needs the extra cluster."
        ),
    ] = None,
    repeats: Annotated[
        int | None, typer.Option(metavar="N", help="Repeats, in place of the study's number; more can be added later.")
    ] = None,
    shard: Annotated[
        int | None, typer.Option(metavar="N", help="Runs in each file of results; default: as many as take about 3 s.")
    ] = None,
    dry_run: Annotated[bool, typer.Option(help="Only check the study, count its runs and time a few of them.")] = False,
    json: options.Json = False,
    report: options.Report = None,
    quiet: options.Quiet = False,
) -> None:
    """Compute the missing runs of a study and store them in DIR.

    The numbers do not depend on --jobs and --shard. Ctrl-C finishes the shards under way; run the same command
    again to go on.
    """
    from hapticnet.checks import check_integer
    from hapticnet.cli.console import check_outputs, deliver
    from hapticnet.errors import SettingsError, UnavailableError
    from hapticnet.experiment.provenance import provenance
    from hapticnet.sweep import engine
    from hapticnet.sweep.store import Store, arrow
    from hapticnet.sweep.study import read_study
    from hapticnet.sweep.tasks import plan_of

    if jobs is not None and scheduler is not None:
        raise SettingsError("--jobs are processes here, and --scheduler has its own; give one of them")
    if shard is not None:
        check_integer("--shard", shard, 1, 10**9)
    arrow()
    file = read_study(study)
    plan = plan_of(file, repeats)
    check_outputs(report, inputs=[study])
    cores = len(os.sched_getaffinity(0)) if jobs is None else jobs
    if dry_run:
        counts = {"combinations": plan.cells, "repeats": plan.repeats, "runs": plan.runs, "workers": cores}
        found = engine.estimate(plan, cores, shard_runs=shard)
        deliver({"study": plan.name, **counts, **found}, as_json=json, file=report)
        return
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
                    sizes=engine.Sizes(shard, plan.sharing),
                    is_stopped=lambda: bool(taken),
                    on_progress=show,
                )
            finally:
                pool.close()
        if progress.failed:
            console.warn(
                f"{progress.failed:,} runs have an error in the place of figures, the first: {progress.first_error}"
            )
        if progress.stopped:
            console.say(f"stopped with {progress.done:,} of {progress.runs:,} runs; the same command goes on")
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
    """Yield the signals that came: the first SIGINT or SIGTERM stops the sweep, the second ends it at once."""
    taken: list[int] = []

    def take(number: int, _frame: FrameType | None) -> None:
        if taken:
            raise KeyboardInterrupt
        taken.append(number)

    if threading.current_thread() is not threading.main_thread():  # no other thread can listen to them
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
    """Yield what shows the progress of a study: a bar on a terminal, a line now and then elsewhere."""
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
        return "finishing the shards in hand"
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
