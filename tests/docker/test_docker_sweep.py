"""A study on a Dask cluster of several hosts, network namespaces or containers; one worker is killed in the middle."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest
from pyarrow import parquet

from hapticnet.sweep.folder import SHARDS

pytestmark = [pytest.mark.docker, pytest.mark.timeout(900)]

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120.0
SCHEDULER_IP = ("10.231.48.1", "10.231.49.1")
WORKER_IP = ("10.231.48.2", "10.231.49.2")
STUDY = """
name = "cluster"
task = "felt"
seed = 5
repeats = 12

[axes]
codec = ["deadband", "adaptive-predictive", "linear-predictive"]
multiplier = [1, 2, 4]
delay = ["5ms", "25ms"]
loss = [0, "5%"]
"""


def wait_until(condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it takes too long"
        time.sleep(0.05)


def rows(folder):
    found = [row for file in sorted(folder.glob(SHARDS)) for row in parquet.read_table(file).to_pylist()]
    return sorted(found, key=lambda row: row["run"])


def swept_here(tmp_path):
    """Return the rows that one process gives."""
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    command = [sys.executable, "-m", "hapticnet", "sweep", "run", study, "--out", tmp_path / "here", "--workers", "1"]
    subprocess.run(command, check=True, cwd=ROOT, capture_output=True)
    return rows(tmp_path / "here")


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@pytest.fixture
def hosts(tool_is_missing):
    """Return the names of three namespaces: the first can reach the two others."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        tool_is_missing("network namespaces need iproute2 and root")
    tag = uuid.uuid4().hex[:6]
    names = [f"hn-{role}-{tag}" for role in ("scheduler", "worker1", "worker2")]
    try:
        for name in names:
            ip("netns", "add", name)
            ip("-n", name, "link", "set", "lo", "up")
        for number, worker in enumerate(names[1:]):
            here, there = f"vs{number}{tag}", f"vw{number}{tag}"
            ip("link", "add", here, "netns", names[0], "type", "veth", "peer", "name", there, "netns", worker)
            for name, device, address in (
                (names[0], here, SCHEDULER_IP[number]),
                (worker, there, WORKER_IP[number]),
            ):
                ip("-n", name, "addr", "add", f"{address}/24", "dev", device)
                ip("-n", name, "link", "set", device, "up")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


@pytest.fixture
def start(tmp_path):
    """Return what starts a command on a host; all its processes are ended afterwards."""
    started = []

    def run(host, *command):
        with (tmp_path / f"{host}-{len(started)}.log").open("wb") as log:
            process = subprocess.Popen(
                ["ip", "netns", "exec", host, sys.executable, "-m", *map(str, command)],
                cwd=ROOT,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        started.append(process)
        return process, tmp_path / log.name

    yield run
    for process in started:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_a_worker_on_another_host_is_killed_and_nothing_is_lost_or_comes_twice(hosts, start, tmp_path):
    truth = swept_here(tmp_path)
    scheduler, one, other = hosts
    start(scheduler, "distributed.cli.dask_scheduler", "--port", "8786", "--no-dashboard")
    address = f"tcp://{SCHEDULER_IP[0]}:8786"
    worker = ("distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard")
    first, first_log = start(one, *worker, address)
    _, other_log = start(other, *worker, f"tcp://{SCHEDULER_IP[1]}:8786")
    for log in (first_log, other_log):
        wait_until(lambda log=log: "Registered to" in log.read_text())
    out = tmp_path / "cluster"
    command = ("hapticnet", "sweep", "run", tmp_path / "study.toml", "--out", out, "--shard", "8")
    sweep, log = start(scheduler, *command, "--scheduler", address, "--json")
    wait_until(lambda: len(list(out.glob(SHARDS))) >= 6 or sweep.poll() is not None)
    os.killpg(first.pid, signal.SIGKILL)
    assert sweep.wait(PATIENCE_S) == 0, log.read_text()
    report = json.loads(log.read_text())
    assert report["complete"]
    assert report["poison"] == []
    assert report["computed"] == len(truth) == 432
    assert rows(out) == truth
