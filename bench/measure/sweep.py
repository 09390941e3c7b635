"""What hapticnet sweep costs over its runs, and what a second worker gains: wall-clock and processor time.

Processor time is what counts on a machine with other work: wall-clock figures hold only for the load that is reported.
"""

import argparse
import os
import resource
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import record

from hapticnet.sweep.conduct import Sizes, conduct
from hapticnet.sweep.folder import Folder
from hapticnet.sweep.grid import Shard
from hapticnet.sweep.local import LocalPool
from hapticnet.sweep.planning import AnyPlan, plan_of
from hapticnet.sweep.runs import rows_of, runs_of
from hapticnet.sweep.study import StudyFile, parse_study

STUDY = """
name = "overhead"
task = "felt"
seed = {seed}
repeats = {repeats}

[axes]
codec = ["deadband", "adaptive-predictive", "linear-predictive", "level-crossing"]
multiplier = [1, 2, 4]
delay = ["5ms", "25ms"]
loss = [0, "2%"]
"""
WARM_RUNS = 4


def planned(seed: int, repeats: int) -> AnyPlan:
    """Return the plan of a study with 48 runs in each repeat."""
    text = STUDY.format(seed=seed, repeats=repeats)
    return plan_of(StudyFile(parse_study(text, "bench"), text, "bench", Path()))


def children_cpu_s() -> float:
    """Return the processor time of all processes that this one waited for [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def alone(plan: AnyPlan) -> dict[str, float]:
    """Compute all runs in this process, without shards and files; return what that takes."""
    runner = plan.runner()
    rows_of(plan, runner, Shard(0, WARM_RUNS))
    began_s, cpu_s = time.perf_counter(), time.process_time()
    rows_of(plan, plan.runner(), Shard(0, runs_of(plan)))
    return {"wall_s": time.perf_counter() - began_s, "cpu_s": time.process_time() - cpu_s}


def swept(plan: AnyPlan, workers: int) -> dict[str, float]:
    """Sweep all runs into an empty folder; return what that takes."""
    with tempfile.TemporaryDirectory() as path:
        folder = Folder(Path(path))
        there = folder.open(plan, "", {})
        began_s, cpu_s, children_s = time.perf_counter(), time.process_time(), children_cpu_s()
        pool = LocalPool(plan, workers)
        try:
            done = conduct(plan, folder, there, pool, sizes=Sizes())
        finally:
            pool.close()
        wall_s = time.perf_counter() - began_s
    if done.done != runs_of(plan):
        raise SystemExit(f"only {done.done} of {runs_of(plan)} runs were computed")
    return {
        "wall_s": wall_s,
        "parent_cpu_s": time.process_time() - cpu_s,
        "workers_cpu_s": children_cpu_s() - children_s,
        "shards_cpu_s": done.worker_cpu_s,
        "busy": done.worker_s / (workers * wall_s),
        "shards": done.shards,
    }


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure in turns and return medians."""
    plan, tiny = planned(arguments.seed, arguments.repeats), planned(arguments.seed, 1)
    turns: dict[str, list[dict[str, float]]] = {"alone": [], "start": [], "one": [], "two": []}
    for _ in range(arguments.repetitions):
        turns["alone"].append(alone(plan))
        start = swept(tiny, 1)
        start["start_cpu_s"] = start["parent_cpu_s"] + start["workers_cpu_s"] - start["shards_cpu_s"]
        turns["start"].append(start)
        turns["one"].append(swept(plan, 1))
        turns["two"].append(swept(plan, 2))
    found = {
        name: {key: statistics.median(each[key] for each in measured) for key in measured[0]}
        for name, measured in turns.items()
    }
    runs, one, two = runs_of(plan), found["one"], found["two"]
    start_s = found["start"]["start_cpu_s"]

    def overheads(of: str, workers: int) -> list[float]:
        """Return, for each turn, the processor time besides the runs over that of the runs, without the start."""
        return [
            (each["parent_cpu_s"] + each["workers_cpu_s"] - workers * start_s) / single["cpu_s"] - 1.0
            for each, single in zip(turns[of], turns["alone"], strict=True)
        ]

    return {
        "load_average": os.getloadavg()[0],
        "runs": runs,
        "ms_cpu_per_run": 1e3 * found["alone"]["cpu_s"] / runs,
        "start_cpu_s_per_worker": start_s,
        "around_shards_one": (one["parent_cpu_s"] + one["workers_cpu_s"] - start_s) / one["shards_cpu_s"] - 1.0,
        "around_shards_two": (two["parent_cpu_s"] + two["workers_cpu_s"] - 2.0 * start_s) / two["shards_cpu_s"] - 1.0,
        "overhead_one": statistics.median(overheads("one", 1)),
        "overhead_two": statistics.median(overheads("two", 2)),
        "speedup_wall": statistics.median(
            each["wall_s"] / other["wall_s"] for each, other in zip(turns["one"], turns["two"], strict=True)
        ),
        "speedup_cpu": 2.0 * two["busy"] / one["busy"] * one["shards_cpu_s"] / two["shards_cpu_s"],
        "medians": found,
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--repeats", type=record.within(1), default=20, help="repeats of the study: 48 runs each")
    parser.add_argument("--repetitions", type=record.within(1), default=3)
    record.run(parser, measure, unit="as in each name; overheads and speed-ups are ratios")


if __name__ == "__main__":
    main()
