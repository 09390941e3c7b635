"""Build and run the compose file: a slave and a master in a container each, with an emulated network between them."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

pytestmark = [pytest.mark.docker, pytest.mark.timeout(900)]

DOCKER = Path(__file__).parents[2] / "docker"
ROLES = {"slave", "master"}
RESULTS = DOCKER / "results"
LIST_KEYS = "find /keys /public -type f -printf '%p:%m\\n'"


@pytest.fixture
def compose(docker_compose):
    """Return a function that runs a compose command in a scenario; containers are removed afterwards."""
    # If only the host can reach the package index, build images on its network.
    RESULTS.mkdir(exist_ok=True)
    RESULTS.chmod(0o777)  # the account of the image writes there
    environment = {"BUILD_NETWORK": "host", "INSERTIONS": "1"} | os.environ

    def run(scenario, *arguments):
        command = [
            *docker_compose,
            "-f",
            DOCKER / "compose.yaml",
            "--env-file",
            DOCKER / "scenarios" / f"{scenario}.env",
        ]
        return subprocess.run([*command, *arguments], capture_output=True, text=True, check=False, env=environment)

    yield run
    run("loopback", "down", "--volumes", "--rmi", "local")
    shutil.rmtree(RESULTS, ignore_errors=True)


def probes(compose, scenario, role):
    """Return the exit codes of a container's newest health checks."""
    container = compose(scenario, "ps", "--all", "-q", role).stdout.strip()
    shown = subprocess.run(
        ["docker", "inspect", "--format", "{{json .State.Health.Log}}", container],
        capture_output=True,
        text=True,
        check=True,
    )
    return [probe["ExitCode"] for probe in json.loads(shown.stdout)]


def test_every_scenario_plays_an_insertion_and_reports_on_stdout_and_in_the_folder(compose):
    built = compose("loopback", "build")
    assert built.returncode == 0, built.stderr[-2000:]
    reductions = {}
    healthy = set()
    for scenario in sorted(path.stem for path in (DOCKER / "scenarios").glob("*.env")):
        done = compose(scenario, "up", "--abort-on-container-exit", "--exit-code-from", "master")
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        assert "end_reason" in done.stdout
        healthy |= {role for role in ROLES if 0 in probes(compose, scenario, role)}
        master, slave = (json.loads((RESULTS / f"{name}.json").read_text()) for name in ("master", "slave"))
        assert master["end_reason"] == "done"
        assert master["sealed"]
        assert slave["sessions"][-1]["sealed"]
        assert slave["sessions"][-1]["breaches"] == 3
        reductions[scenario] = slave["sessions"][-1]["packet_rate_reduction"]
        if scenario == "transatlantic":
            assert master["round_trip"]["p50_us"] > 70_000
            assert master["channel_out"]["lost"] > 0
            assert slave["channel_out"]["lost"] > 0
    assert healthy == ROLES, "the master's run is short, but not in every scenario too short for a probe"
    # Each side has its own private key, readable by its owner alone, and of the other only the public key.
    files = {
        role: compose("loopback", "run", "--rm", "--no-deps", "--entrypoint", LIST_KEYS, role).stdout.split()
        for role in ("slave", "master")
    }
    public = ["/public/master", "/public/slave"]
    assert sorted(files["slave"]) == [
        "/keys/key.toml:600",
        "/keys/masters.toml:644",
        *(f"{each}:644" for each in public),
    ]
    assert sorted(files["master"]) == ["/keys/key.toml:600", *(f"{each}:644" for each in public)]
    assert reductions["uncompressed"] == 0.0
    assert reductions["loopback"] > 0.8
