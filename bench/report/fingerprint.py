"""Short fingerprints of results, to notice when the same run gives something else."""

import math
import re
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, Final

TIMED: Final = re.compile(r"nanoseconds|ns_per|cpu|memory|load_average")
"""Figures that differ from run to run."""


def fingerprint(results: Any) -> dict[str, list[float]]:
    """Return for each column of the results how many numbers it has, their sum, and their sum weighted by place.

    Times are left out. Numbers that are not finite and None count as zero, true as one.
    """
    columns: defaultdict[str, list[float]] = defaultdict(list)
    for name, value in _numbers(results, ""):
        if not TIMED.search(name):
            columns[name].append(value)
    return {
        name: [len(values), math.fsum(values), math.fsum(place * value for place, value in enumerate(values, 1))]
        for name, values in sorted(columns.items())
    }


def changed(before: dict[str, list[float]], after: dict[str, list[float]], tolerance: float = 1e-6) -> list[str]:
    """Return the columns that differ between two fingerprints by more than rounding."""
    return sorted(
        name
        for name in before.keys() | after.keys()
        if name not in before
        or name not in after
        or not all(
            math.isclose(old, new, rel_tol=tolerance, abs_tol=1e-12)
            for old, new in zip(before[name], after[name], strict=True)
        )
    )


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _numbers(each, f"{name}.{key}".removeprefix("."))
    elif isinstance(value, list):
        for each in value:
            yield from _numbers(each, name)
    elif isinstance(value, int | float):
        yield name, float(value) if math.isfinite(value) else 0.0
    elif value is None:
        yield name, 0.0
