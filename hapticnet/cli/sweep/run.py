"""``hapticnet sweep run``: compute the missing runs of a study."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.sweep.conduct import Progress
    from hapticnet.sweep.planning import AnyPlan
    from hapticnet.sweep.pool import Pool


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
    from hapticnet.cli.sweep.progress import shown
    from hapticnet.errors import SettingsError, UnavailableError
    from hapticnet.experiment.provenance import provenance
    from hapticnet.sweep.conduct import Sizes, conduct
    from hapticnet.sweep.folder import Folder
    from hapticnet.sweep.planning import plan_of
    from hapticnet.sweep.stopping import stopped_by_signals
    from hapticnet.sweep.study import read_study
    from hapticnet.sweep.table import arrow

    if jobs is not None and scheduler is not None:
        raise SettingsError("--jobs are processes here, and --scheduler has its own; give one of them")
    if shard is not None:
        check_integer("--shard", shard, 1, 10**9)
    arrow()
    file = read_study(study)
    plan = plan_of(file, repeats)
    check_outputs(report, inputs=[study])
    if dry_run:
        deliver(_estimate(plan, jobs, shard), as_json=json, file=report)
        return
    if out_dir is None:
        raise SettingsError("--out-dir DIR is missing: the folder of the results")
    folder = Folder(out_dir)
    with folder.held():
        there = folder.open(plan, file.text, {"provenance": provenance()})
        with stopped_by_signals() as stop, shown(plan.name, quiet=quiet or json) as show:
            pool = _pool(plan, jobs, scheduler)
            try:
                found = conduct(
                    plan,
                    folder,
                    there,
                    pool,
                    sizes=Sizes(shard, plan.sharing),
                    is_stopped=stop,
                    on_progress=show.update,
                )
            finally:
                pool.close()
        show.notes(found)
        deliver(_account(plan, out_dir, found), as_json=json, file=report)
    if found.stopped and stop.signal is not None:
        raise typer.Exit(128 + stop.signal)
    if found.poison:
        raise UnavailableError(
            f"{len(found.poison)} shards could not be computed, because their workers ended each time; the files"
            f" {out_dir}/*.poison.json tell which; run the same command again to try them again"
        )


def _pool(plan: "AnyPlan", jobs: int | None, scheduler: str | None) -> "Pool":
    if scheduler is not None:
        from hapticnet.sweep.cluster import ClusterPool

        return ClusterPool(plan, scheduler)
    from hapticnet.sweep.local import LocalPool

    return LocalPool(plan, _cores() if jobs is None else jobs)


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _estimate(plan: "AnyPlan", jobs: int | None, shard: int | None) -> dict[str, Any]:
    from dataclasses import asdict

    from hapticnet.sweep.estimate import estimate
    from hapticnet.sweep.runs import runs_of

    number = _cores() if jobs is None else jobs
    counts = {"combinations": plan.cells, "repeats": plan.repeats, "runs": runs_of(plan), "workers": number}
    return {"study": plan.name, **counts, **asdict(estimate(plan, number, shard_runs=shard))}


def _account(plan: "AnyPlan", out: Path, found: "Progress") -> dict[str, Any]:
    return {
        "study": plan.name,
        "digest": plan.digest,
        "folder": str(out),
        "runs": found.runs,
        "done": found.done,
        "computed": found.computed,
        "failed": found.failed,
        "first_error": found.first_error,
        "shards": found.shards,
        "lost_workers": found.broken,
        "poison": [f"{shard.first}-{shard.end}" for shard in found.poison],
        "seconds": found.seconds,
        "runs_per_s": found.runs_per_s,
        "worker_seconds": found.worker_s,
        "worker_cpu_seconds": found.worker_cpu_s,
        "complete": found.done == found.runs,
    }
