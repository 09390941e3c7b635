"""What a sweep needs of workers, wherever they are."""

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from hapticnet.sweep.grid import Shard


@dataclass(frozen=True, slots=True)
class Computed:
    """A shard that was computed.

    Attributes
    ----------
    content
        Its Parquet file.
    failed
        Number of runs with an error in the place of figures.
    first_error
        The first of these errors.
    seconds, cpu_s
        Duration, and processor time of the worker [s].
    """

    shard: Shard
    content: bytes
    failed: int
    first_error: str | None
    seconds: float
    cpu_s: float


@dataclass(frozen=True, slots=True)
class Broken:
    """A shard whose worker ended, or that failed as a whole, for `reason`.

    Attributes
    ----------
    final
        Whether it was tried often enough.
    """

    shard: Shard
    reason: str
    final: bool = False


Outcome: TypeAlias = Computed | Broken


class Pool(Protocol):
    """Workers that compute shards."""

    @property
    def workers(self) -> int:
        """Number of workers at present."""
        ...

    @property
    def room(self) -> int:
        """How many more shards it should be given now."""
        ...

    @property
    def in_hand(self) -> int:
        """Number of shards it was given and has not returned."""
        ...

    def submit(self, shard: Shard) -> None:
        """Let a worker compute a shard.

        Raises
        ------
        UnavailableError
            If there are no workers any more.
        """
        ...

    def outcomes(self, timeout_s: float) -> list[Outcome]:
        """Wait until something is finished, at most so long, and return it.

        Raises
        ------
        UnavailableError
            If the workers cannot be reached any more.
        """
        ...

    def drop_waiting(self) -> None:
        """Take back the shards that nobody computes yet."""
        ...

    def close(self) -> None:
        """End the workers at once."""
        ...
