"""The origin of a result: version, date, machine and command, for every file of results."""

import os
import platform
import shlex
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hapticnet.errors import printable


def provenance() -> dict[str, Any]:
    """Return version, date (UTC), machine and command of this process, for JSON."""
    return {
        "version": own_version(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": describe_machine(),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
    }


def provenance_lines() -> list[str]:
    """Return the same as one line of text each, for the comments at the top of a table."""
    origin = provenance()
    origin["machine"] = ", ".join(f"{key} {value}" for key, value in origin["machine"].items())
    return [f"{key}: {printable(str(value))}" for key, value in origin.items()]


@cache
def describe_machine() -> dict[str, str | int | None]:
    """Return processor, cores, system and Python."""
    return {
        "processor": _processor_name(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
    }


def own_version() -> str:
    """Return the version of hapticnet. The package cannot be imported here: it imports the API, a higher layer."""
    try:
        return version("hapticnet")
    except PackageNotFoundError:
        return "not installed"


def _processor_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
