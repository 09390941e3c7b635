"""A study whose runs take a millisecond, and what reads the rows of a folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from hapticnet.codec import registry
from hapticnet.sweep.plan import Plan, plan_of
from hapticnet.sweep.store import SHARDS
from hapticnet.sweep.study import read_study

SMALL = """
name = "small"
seed = 7
repeats = 4

[axes]
recording = "force.npz"
codec = ["deadband", "linear-predictive"]
multiplier = [1, 2.5]
delay = ["0ms", "5ms"]
jitter = "normal:2ms"
loss = [0, "10%"]

[show]
by = ["codec", "delay_ms"]
x = "packets_per_s"
y = "felt_rmse_n"
line = ["codec"]
panel = ["delay_ms"]
"""


@pytest.fixture(autouse=True)
def no_codecs_of_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the codecs that other tests made known."""
    monkeypatch.setattr(registry, "_user_codecs", {})


@pytest.fixture
def write_study(tmp_path: Path) -> Callable[..., Path]:
    """Return what writes a study, and the recording that it names, into a folder."""
    t_s = np.arange(200) * 1e-3
    force = 1.0 + np.sin(20.0 * t_s)
    np.savez(tmp_path / "force.npz", t_s=t_s, force_n=force, position_m=t_s * 0.01)

    def write(text: str = SMALL, name: str = "study.toml") -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.fixture
def plan(write_study: Callable[..., Path]) -> Plan:
    """Return the plan of that study: 64 runs."""
    return plan_of(read_study(write_study()))


@pytest.fixture
def rows() -> Callable[[Path], list[dict[str, Any]]]:
    """Return what reads all rows of a folder, in the order of their runs."""

    def read(folder: Path) -> list[dict[str, Any]]:
        tables = [parquet.read_table(file) for file in sorted(folder.glob(SHARDS))]
        return sorted((row for table in tables for row in table.to_pylist()), key=lambda row: row["run"])

    return read
