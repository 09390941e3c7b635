"""Docker, where an engine runs."""

import shutil
import subprocess

import pytest


def succeeds(*command: str) -> bool:
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.fixture
def docker_compose(tool_is_missing) -> list[str]:
    """Return the command of Docker Compose."""
    if shutil.which("docker") is None or not succeeds("docker", "info"):
        tool_is_missing("no Docker engine runs here")
    plugin = succeeds("docker", "compose", "version")
    if not plugin and shutil.which("docker-compose") is None:
        tool_is_missing("neither 'docker compose' nor 'docker-compose' is installed")
    return ["docker", "compose"] if plugin else ["docker-compose"]
