"""A study on a Dask cluster of several containers; one worker is killed in the middle."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pyarrow import parquet

from hapticnet.sweep.store import SHARDS
from tests.ready import wait_until

pytestmark = [pytest.mark.docker, pytest.mark.timeout(900)]

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120.0


def rows(folder):
    found = [row for file in sorted(folder.glob(SHARDS)) for row in parquet.read_table(file).to_pylist()]
    return sorted(found, key=lambda row: row["run"])


@pytest.fixture
def compose(docker_compose):
    """Return a function that runs a compose command; containers and results are removed afterwards."""
    environment = {"BUILD_NETWORK": "host", "REPEATS": "2", "STUDY": "repair"} | os.environ

    def run(*arguments, check=True):
        command = [*docker_compose, "-f", str(ROOT / "docker" / "compose.sweep.yaml"), *arguments]
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
