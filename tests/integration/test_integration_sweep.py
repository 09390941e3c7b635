"""A sweep as a process of its own: interrupted, then killed with its workers, then finished."""

import json
import signal

from pyarrow import parquet

from hapticnet.sweep.runs import Shard, rows_of
from hapticnet.sweep.store import SHARDS
from hapticnet.sweep.study import read_study
from hapticnet.sweep.tasks import plan_of
from tests.ready import children_of, is_running, wait_until

STUDY = """
name = "interrupted"
task = "felt"
repeats = 4

[axes]
hand = "scripted:insertions=1,approach_s=0.1,push_s=0.5,withdraw_s=0.1,rest_s=0.1"
codec = ["deadband", "linear-predictive"]
multiplier = [1, 2, 4]
loss = [0, "5%"]
"""
PATIENCE_S = 60.0


def test_an_interrupted_and_a_killed_sweep_go_on_where_they_were(start, tmp_path):
    study, out = tmp_path / "study.toml", tmp_path / "out"
    study.write_text(STUDY)
    command = ("sweep", "run", str(study), "--out-dir", str(out), "--jobs", "2", "--shard", "3", "--json")
    count = 0

    def grows():
        return len(list(out.glob(SHARDS))) > count

    first = start(*command)
    wait_until(grows)
    assert first.end(signal.SIGINT) == 130
    assert first.said() == ""
    count = len(list(out.glob(SHARDS)))
    assert first.report()["shards"] == count
    assert 0 < first.report()["done"] < 48

    second = start(*command)
    wait_until(grows)
    workers = children_of(second.process.pid)
    assert len(workers) >= 2
    assert second.end(signal.SIGKILL) == -signal.SIGKILL
    wait_until(lambda: not any(map(is_running, workers)))
    assert len(list(out.glob(SHARDS))) < 16

    third = start(*command)
    assert third.process.wait(PATIENCE_S) == 0, third.said()
    assert json.loads(third.output.read_text())["complete"]
    rows = [row for file in sorted(out.glob(SHARDS)) for row in parquet.read_table(file).to_pylist()]
    plan = plan_of(read_study(study))
    assert rows == rows_of(plan, plan.runner(), Shard(0, plan.runs))
