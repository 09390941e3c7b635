"""What every benchmark writes beside its results: which code, on which machine, and how often."""

import json
import os
import platform
import subprocess
from pathlib import Path
from typing import Any


def write(path: Path, *, name: str, seed: int, unit: str, repetitions: int, results: Any) -> None:
    """Write the results of the benchmark `name`, all in `unit`, as JSON."""
    record = {
        "name": name,
        "revision": describe_revision(),
        "seed": seed,
        "unit": unit,
        "repetitions": repetitions,
        "machine": describe_machine(),
        "results": results,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def describe_revision() -> str:
    """Return what git calls this code, "unknown" outside a repository."""
    command = ["git", "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def describe_machine() -> dict[str, str | int | None]:
    """Return the machine and the Python that the figures hold for."""
    return {
        "processor": _processor_name(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
    }


def _processor_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
