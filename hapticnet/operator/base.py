"""The interface of an operator."""

from typing import Protocol

from hapticnet.samples import PositionSample


class Operator(Protocol):
    """A source of tool positions: a script, a recording or a person."""

    @property
    def axes(self) -> int:
        """Number of axes of a position."""
        ...

    @property
    def duration_us(self) -> int | None:
        """Duration of the motion [µs], or None if it is endless."""
        ...

    def sample(self, t_us: int) -> PositionSample:
        """Return the position of the tool at `t_us` [µs] from the start of the motion."""
        ...
