"""Parse ``--operator`` and make the operator."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hapticnet.operator.base import Operator


def make_operator(spec: str, *, insertions: int, seed: int, say: Callable[[str], None]) -> "Operator":
    """Return the operator written as `spec`; `say` is called with notes about what was read.

    Raises
    ------
    SettingsError
        If there is no such operator.
    FileError
        If its file cannot be used.
    """
    import numpy as np

    from hapticnet.errors import SettingsError
    from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
    from hapticnet.operator.trace import load_trace

    if spec == "scripted":
        return ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng([seed, 3]))
    if spec.startswith("trace:") and spec != "trace:":
        file, columns = _trace(spec)
        operator, notes = load_trace(file, position=columns)
        for note in notes:
            say(f"{file}: {note}")
        return operator
    raise SettingsError(f"unknown operator {spec!r}; there are: scripted, trace:FILE[:COLUMN,…]")


def operator_file(spec: str) -> Path | None:
    """Return the file that an operator is read from; None if there is none."""
    return _trace(spec)[0] if spec.startswith("trace:") else None


def _trace(spec: str) -> tuple[Path, str | None]:
    """Return file and columns of trace:FILE[:COLUMN,…]; a file may have a colon in its name."""
    whole = spec.removeprefix("trace:")
    file, colon, columns = whole.rpartition(":")
    return (Path(file), columns) if colon and not Path(whole).exists() else (Path(whole), None)
