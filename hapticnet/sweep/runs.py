"""The runs of a study, numbered: their grid, and the shards in which they are computed and stored."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

Kind: TypeAlias = Literal["int", "float", "text"]
Columns: TypeAlias = dict[str, Kind]  # names and types of the columns of a table
Row: TypeAlias = dict[str, Any]  # one run: a value, or None, for each column


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


def overlap(shards: Sequence[Shard]) -> tuple[Shard, Shard] | None:
    """Return two shards that have a run in common; None if there are none."""
    return next(((one, other) for one, other in itertools.pairwise(sorted(shards)) if one.end > other.first), None)


class Cutter:
    """Cuts the runs that are in no shard yet into shards."""

    def __init__(self, there: Iterable[Shard], runs: int) -> None:
        gaps, at = [], 0
        for shard in [*sorted(there), Shard(runs, runs)]:
            if shard.first > at:
                gaps.append(Shard(at, shard.first))
            at = shard.end
        self._gaps = gaps[::-1]
        self.left = sum(gap.runs for gap in gaps)

    def cut(self, most: int) -> Shard | None:
        """Return the next shard of at most this many runs; None if nothing is left."""
        if not self._gaps:
            return None
        gap = self._gaps.pop()
        end = min(gap.end, gap.first + max(1, most))
        if end < gap.end:
            self._gaps.append(Shard(end, gap.end))
        self.left -= end - gap.first
        return Shard(gap.first, end)
