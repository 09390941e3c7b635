"""Every combination of the values of some axes, by number, and the ranges of runs that are computed together."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple


@dataclass(frozen=True, slots=True)
class Grid:
    """The product of some axes. The last axis changes fastest."""

    axes: tuple[tuple[Any, ...], ...]

    def __len__(self) -> int:
        return math.prod(len(axis) for axis in self.axes)

    def __getitem__(self, cell: int) -> tuple[Any, ...]:
        values: list[Any] = []
        for axis in reversed(self.axes):
            cell, place = divmod(cell, len(axis))
            values.append(axis[place])
        return tuple(reversed(values))


class Shard(NamedTuple):
    """Runs that are computed and stored together: from `first` to before `end`."""

    first: int
    end: int

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.end - self.first


def gaps(shards: Iterable[Shard], runs: int) -> list[Shard]:
    """Return the ranges of 0 … `runs` that no shard covers, in order."""
    missing, at = [], 0
    for shard in sorted(shards):
        if shard.first > at:
            missing.append(Shard(at, min(shard.first, runs)))
        at = max(at, shard.end)
    if at < runs:
        missing.append(Shard(at, runs))
    return [gap for gap in missing if gap.runs > 0]


def overlap(shards: Sequence[Shard]) -> tuple[Shard, Shard] | None:
    """Return two shards that have a run in common; None if there are none."""
    ordered = sorted(shards)
    return next(((one, other) for one, other in itertools.pairwise(ordered) if one.end > other.first), None)


class Cutter:
    """Cuts what is missing into shards."""

    def __init__(self, missing: Iterable[Shard]) -> None:
        self._gaps = [gap for gap in missing if gap.runs]
        self._gaps.reverse()
        self.left = sum(gap.runs for gap in self._gaps)

    def cut(self, most: int) -> Shard | None:
        """Return the next shard of at most so many runs; None if nothing is left."""
        if not self._gaps:
            return None
        gap = self._gaps.pop()
        end = min(gap.end, gap.first + max(1, most))
        if end < gap.end:
            self._gaps.append(Shard(end, gap.end))
        self.left -= end - gap.first
        return Shard(gap.first, end)
