import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
sys.path.append(str(REPOSITORY / "bench" / "report"))

from plan import BENCHMARKS  # noqa: E402 - scripts of bench/ find what stands beside them only with this path


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
    plan = {each.name: each for each in BENCHMARKS}

    def results(name):
        file = folder / f"{name}.json"
        if not file.exists():
            if name in ("codec_speed", "floods", "real_time", "sessions") and shutil.which("gcc") is None:
                tool_is_missing("gcc is missing: the C loops cannot be compiled")
            if name == "sessions" and not Path("/usr/include/openssl/evp.h").exists():
                tool_is_missing("libssl-dev is missing: the load generator cannot be compiled")
            done = bench(f"measure/{name}.py", *plan[name].quick.split(), "--json", file)
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
