"""One report and one set of metrics of several workers."""

import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.stats import Distribution
from hapticnet.runtime.metrics import SlaveFigures
from hapticnet.runtime.outlet import STDERR
from hapticnet.runtime.workers.crew import Worker

OF_NOW: Final = ("sessions", "realtime", "kernel_drops")
"""Values that end with a process, or that its socket keeps: those of processes that have ended are not added."""

LOWEST: Final = ("realtime",)
"""Values of which the lowest is shown, not the sum."""

SUMMED: Final = ("never_used", "throttled", "unkeyed", "strangers", "to_strangers")


def news(node: SlaveNode, figures: SlaveFigures | None) -> dict[str, Any]:
    """Return what a worker tells its parent twice a second; without `figures`, only what takes no time."""
    told: dict[str, Any] = {"masters": node.session_count, "cpu_s": time.process_time()}
    if figures is not None:
        distributions = figures.distributions().items()
        told["values"] = figures.values()
        told["counts"] = {name: each.counts() for name, each in distributions if each is not None}
    return told


def status(workers: Sequence[Worker]) -> str:
    """Return the status line of a slave with workers."""
    masters = sum(each.news.get("masters", 0) for each in workers)
    return f"{masters} masters, {sum(each.ready is not None for each in workers)} of {len(workers)} workers"


def merged_values(workers: Sequence[Worker]) -> dict[str, Any]:
    """Return the metrics of all workers. Counters include processes that have ended."""
    found = [each.news.get("values", {}) for each in workers]
    total: dict[str, Any] = {}
    for values in found:
        total = added(total, values)
    for values in (before.get("values", {}) for each in workers for _, before in each.ended):
        total = added(total, {name: value for name, value in values.items() if name not in OF_NOW})
    for name in LOWEST:
        total[name] = min((values.get(name, 0.0) for values in found), default=0.0)
    total["log_lines_left_out"] = total.get("log_lines_left_out", 0) + STDERR.left_out
    return total | {
        "worker_up": {str(each.number): float(each.ready is not None) for each in workers},
        "worker_sessions": {str(each.number): each.news.get("masters", 0) for each in workers},
        "worker_restarts": {str(each.number): len(each.ended) for each in workers},
        "worker_cpu_seconds": {str(each.number): _cpu_s(each) for each in workers},
    }


def merged_distributions(workers: Sequence[Worker]) -> dict[str, Distribution | None]:
    """Return the distributions of all workers."""
    merged: dict[str, Distribution | None] = {"queue_age_seconds": Distribution()}
    for each in workers:
        for content in (each.news, *(before for _, before in each.ended)):
            for name, counts in content.get("counts", {}).items():
                distribution = merged.setdefault(name, Distribution())
                if distribution is not None:
                    distribution.absorb({int(bucket): count for bucket, count in counts.items()})
    return merged


def merged_report(workers: Sequence[Worker]) -> dict[str, Any]:
    """Return the report of a slave with workers: all sessions, sums, and the figures of each worker.

    The sessions of a process that was killed are missing; ``workers`` tells how many they were.
    """
    reports = [(each.process.report if each.process is not None else None) or {} for each in workers]
    merged: dict[str, Any] = {
        "scheduling": _common([report.get("scheduling") for report in reports]),
        "sessions": [session for report in reports for session in report.get("sessions", ())],
    }
    for name in SUMMED:
        total: Any = None
        for report in reports:
            if name in report:
                total = report[name] if total is None else added(total, report[name])
        merged[name] = total if total is not None else 0
    ages = merged_distributions(workers)["queue_age_seconds"]
    overloads = [report["overload"] for report in reports if "overload" in report]
    merged["overload"] = {
        "queue_age_p50_us": ages.percentile(50) if ages is not None else None,
        "queue_age_p99_us": ages.percentile(99) if ages is not None else None,
        "kernel_drops": sum(each["kernel_drops"] or 0 for each in overloads),
        "missed_ticks": None,
        "missed_share": None,
        "scheduling": merged["scheduling"],
        "lines_left_out": STDERR.left_out + sum(each["lines_left_out"] for each in overloads),
    }
    recordings = [report["recording"] for report in reports if "recording" in report]
    if recordings:
        merged["recording"] = {
            "files": sum(each["files"] for each in recordings),
            "sessions_not_recorded": sum(each["sessions_not_recorded"] for each in recordings),
            "stopped": next((each["stopped"] for each in recordings if each["stopped"]), None),
        }
    merged["workers"] = [_of_worker(each, report) for each, report in zip(workers, reports, strict=True)]
    return merged


def recording_faults(workers: Sequence[Worker]) -> list[str]:
    """Return why recordings of workers are incomplete."""
    reports = [each.process.report for each in workers if each.process is not None and each.process.report is not None]
    return sorted({report["recording"]["fault"] for report in reports if report.get("recording", {}).get("fault")})


def added(one: Any, other: Any) -> Any:
    """Return the sum of two numbers, or of two mappings key by key; a missing number is 0."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return {name: added(one.get(name, 0), other.get(name, 0)) for name in {**one, **other}}
    return other if not one else one if not other else one + other


def _of_worker(worker: Worker, report: Mapping[str, Any]) -> dict[str, Any]:
    sessions = report.get("sessions", ())
    return {
        "worker": worker.number,
        "sessions": len(sessions),
        "steps": sum(session["steps"] for session in sessions),
        "cpu_s": round(_cpu_s(worker), 3),
        "restarts": len(worker.ended),
        "ended": [how for how, _ in worker.ended],
        "sessions_lost": sum(before.get("masters", 0) for _, before in worker.ended),
        "hellos_left_out": report.get("hellos_left_out"),
        "scheduling": report.get("scheduling"),
        "overload": report.get("overload"),
    }


def _cpu_s(worker: Worker) -> float:
    return float(sum(each.get("cpu_s", 0.0) for each in (worker.news, *(before for _, before in worker.ended))))


def _common(words: list[Any]) -> Any:
    """Return what all workers say, or the different answers in one line."""
    return "; ".join(sorted({str(each) for each in words if each is not None})) or None
