"""Write the results of a benchmark as JSON, with the code, machine, seed and repetitions they hold for."""

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

from hapticnet.experiment.provenance import provenance


def options(description: str | None, *, seed: int = 1) -> argparse.ArgumentParser:
    """Return a parser with the options that every benchmark has; the first line of `description` is its help."""
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to FILE instead of the terminal")
    parser.add_argument("--seed", type=int, default=seed, help="of all that is drawn; the first if there are several")
    return parser


def write(path: Path | None, *, name: str, seed: int, unit: str, repetitions: int, results: Any) -> None:
    """Write the results of the benchmark `name`, all in `unit`, as JSON; to the terminal if `path` is None."""
    record = {
        "name": name,
        "revision": describe_revision(),
        "seed": seed,
        "unit": unit,
        "repetitions": repetitions,
        **provenance(),
        "results": results,
    }
    text = json.dumps(record, indent=2)
    if path is None:
        print(text)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")
    print(f"wrote {path}")


def describe_revision() -> str:
    """Return git's name of this revision; "unknown" outside a repository."""
    command = ["git", "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()
