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

from hapticnet.sweep.store import SHARDS

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
    command = [sys.executable, "-m", "hapticnet", "sweep", "run", study, "--out-dir", tmp_path / "here", "--jobs", "1"]
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
    command = ("hapticnet", "sweep", "run", tmp_path / "study.toml", "--out-dir", out, "--shard", "8")
    sweep, log = start(scheduler, *command, "--scheduler", address, "--json")
    wait_until(lambda: len(list(out.glob(SHARDS))) >= 6 or sweep.poll() is not None)
    os.killpg(first.pid, signal.SIGKILL)
    assert sweep.wait(PATIENCE_S) == 0, log.read_text()
    report = json.loads(log.read_text())
    assert report["complete"]
    assert report["poison"] == []
    assert report["computed"] == len(truth) == 432
    assert rows(out) == truth


@pytest.fixture
def compose(tool_is_missing):
    """Return a function that runs a compose command; containers and results are removed afterwards."""
    if shutil.which("docker") is None or subprocess.run(["docker", "info"], capture_output=True).returncode:
        tool_is_missing("no Docker engine runs here")
    plugin = subprocess.run(["docker", "compose", "version"], capture_output=True).returncode == 0
    program = ["docker", "compose"] if plugin else ["docker-compose"]
    environment = {"BUILD_NETWORK": "host", "REPEATS": "2", "STUDY": "repair"} | os.environ

    def run(*arguments, check=True):
        command = [*program, "-f", str(ROOT / "docker" / "compose.sweep.yaml"), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0 or not check, done.stdout[-2000:] + done.stderr[-2000:]
        return done.stdout

    yield run
    run("down", "--volumes", "--rmi", "local", check=False)
    shutil.rmtree(ROOT / "docker" / "results", ignore_errors=True)


def test_a_worker_in_a_container_is_killed_and_nothing_is_lost_or_comes_twice(compose, tmp_path):
    results = ROOT / "docker" / "results"
    results.mkdir(exist_ok=True)
    results.chmod(0o777)  # the account of the image writes there
    compose("build")
    compose("up", "-d")
    wait_until(lambda: len(list((results / "sweep").glob(SHARDS))) >= 2)
    compose("kill", "-s", "SIGKILL", "worker1")
    wait_until((results / "sweep.json").exists)
    report = json.loads((results / "sweep.json").read_text())
    assert report["complete"]
    assert report["poison"] == []
    command = [sys.executable, "-m", "hapticnet", "sweep", "run", "studies/repair.toml", "--repeats", "2"]
    subprocess.run([*command, "--out-dir", tmp_path / "here"], check=True, cwd=ROOT, capture_output=True)
    there, here = rows(results / "sweep"), rows(tmp_path / "here")
    assert [row["run"] for row in there] == [row["run"] for row in here] == list(range(240))
    # Another build of numpy may round the last digit differently, so only counts are compared to the bit.
    assert [(row["sent"], row["received"]) for row in there] == [(row["sent"], row["received"]) for row in here]
