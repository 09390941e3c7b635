"""One report and one set of metrics of several workers."""

import pytest

from hapticnet.runtime.metric_table import TABLES
from hapticnet.runtime.metrics import SlaveFigures
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.workers.crew import Worker
from hapticnet.runtime.workers.merge import added, merged_distributions, merged_report, merged_values, news
from hapticnet.runtime.workers.process import WorkerProcess


def worker(number, told, ended=()):
    made = Worker(number)
    made.process = WorkerProcess("module", (), print)
    made.process.ready, made.process.news = {}, told
    made.ended += [("SIGKILL", before) for before in ended]
    return made


@pytest.fixture
def told(loopback):
    """Return what a worker tells after a second in virtual time."""
    link = loopback()
    figures = SlaveFigures(link.slave, Overload("SCHED_FIFO 10", print))
    link.run(1_000_000)
    return news(link.slave, figures)


def test_every_metric_of_workers_has_a_source_and_the_other_way_round(told):
    described = {metric.name: metric for metric in TABLES["workers"]}
    histograms = {name for name, metric in described.items() if metric.kind == "histogram"}
    workers = [worker(0, told), worker(1, told)]
    assert set(merged_distributions(workers)) == histograms
    values = merged_values(workers)
    assert set(values) == set(described) - histograms
    assert all(isinstance(value, dict) == bool(described[name].labels) for name, value in values.items())


def test_values_add_up_and_counters_go_on_where_a_process_that_ended_stood(told):
    workers = [worker(0, told, ended=[told]), worker(1, told)]
    values = merged_values(workers)
    assert values["steps"] == 3 * told["values"]["steps"] > 0
    assert values["datagrams"]["received"] == 3 * told["values"]["datagrams"]["received"]
    assert values["sessions"] == 2, "those of the process that ended are gone"
    assert values["realtime"] == 1.0
    assert values["worker_restarts"] == {"0": 1, "1": 0}


def test_a_worker_that_has_said_nothing_yet_counts_as_nothing(told):
    workers = [worker(0, None), worker(1, told)]
    assert merged_values(workers)["steps"] == told["values"]["steps"]
    assert merged_values([worker(0, None)])["realtime"] == 0.0
    report = merged_report([worker(0, None)])
    assert report["sessions"] == []
    assert report["workers"][0]["sessions"] == 0


def test_queue_ages_of_workers_are_one_distribution():
    workers = [worker(0, {"counts": {"queue_age_seconds": {"400": 99}}}),
            worker(1, {"counts": {"queue_age_seconds": {"400": 98, "700": 3}}})]  # fmt: skip
    ages = merged_distributions(workers)["queue_age_seconds"]
    assert ages.count == 200
    assert ages.percentile(50) == pytest.approx(1.01**401)
    assert ages.percentile(99) == pytest.approx(1.01**701)


def test_sums_go_into_nested_accounts_and_miss_nothing():
    one = {"packets": 1, "by_kind": {"hello": 1}}
    other = {"packets": 2, "by_kind": {"position": 2}, "lost": 3}
    assert added(one, other) == {"packets": 3, "by_kind": {"hello": 1, "position": 2}, "lost": 3}
