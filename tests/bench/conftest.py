import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
QUICK = {
    "codec_speed": ("--samples", 20_000, "--repetitions", 1),
    "codec_stability": ("--quick",),
    "endurance": ("--hours", 0.05, "--wrap-hours", 0.011),
    "felt": ("--quick",),
    "finger_limit": ("--quick", "--seeds", 1),
    "floods": ("--quick", "--seconds", 0.3, "--repetitions", 1),
    "force_loop": ("--quick", "--seeds", 1),
    "hostile_slave": ("--quick",),
    "motion": ("--quick",),
    "fuzz": ("--datagrams", 20_000),
    "positions": ("--quick",),
    "peers": ("--quick", "--seconds", 0.5, "--repetitions", 1, "--no-real-time"),
    "packet_rate": ("--seeds", 1, "--insertions", 1),
    "rate_distortion": ("--quick",),
    "real_time": ("--seconds", 0.3, "--repetitions", 1),
    "recording": ("--quick", "--seconds", 2, "--repetitions", 1, "--kills", 1, "--no-real-time"),
    "repair": ("--quick",),
    "round_trip": ("--seconds", 1, "--repetitions", 1),
    "scene_accuracy": ("--quick",),
    "teleoperation": ("--quick", "--seeds", 1),
    "scene_cost": ("--repetitions", 1),
    "session_tables": ("--repetitions", 5),
    "sessions": ("--quick", "--servers", "echo; slave", "--seconds", 0.4, "--repetitions", 1, "--tries", 1),
    "virtual_time": ("--insertions", 1, "--repetitions", 2),
}
"""Every benchmark, with arguments that take seconds."""


@pytest.fixture(scope="session")
def bench():
    """Return how to run a script of bench/."""

    def run(script, *arguments):
        environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
        command = [sys.executable, REPOSITORY / "bench" / script, *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300, check=False)

    return run


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Return where the records go."""
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="session")
def measured(bench, folder, tool_is_missing):
    """Return how to get the results of a benchmark, which is run once, with a check that its record is whole."""

    def results(name):
        file = folder / f"{name}.json"
        if not file.exists():
            if name in ("codec_speed", "floods", "real_time", "sessions") and shutil.which("gcc") is None:
                tool_is_missing("gcc is missing: the C loops cannot be compiled")
            if name == "sessions" and not Path("/usr/include/openssl/evp.h").exists():
                tool_is_missing("libssl-dev is missing: the load generator cannot be compiled")
            done = bench(f"measure/{name}.py", *QUICK[name], "--json", file)
            assert done.returncode == 0, done.stderr
        record = json.loads(file.read_text())
        assert record["name"] == name
        assert record["revision"]
        assert record["unit"]
        assert type(record["seed"]) is int
        assert record["repetitions"] >= 1
        assert record["machine"]["cores"] >= 1
        assert record["machine"]["python"].endswith(".".join(map(str, sys.version_info[:3])))
        return record["results"]

    return results
