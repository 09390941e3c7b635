"""What an operator is to the rest of hapticnet."""

from typing import Protocol

from hapticnet.samples import PositionSample


class Operator(Protocol):
    """Whoever moves the tool: a script, a recording, a person."""

    @property
    def axes(self) -> int:
        """Number of axes of a position."""
        ...

    @property
    def duration_us(self) -> int | None:
        """How long the motion takes [µs], or None when it does not end."""
        ...

    def sample(self, t_us: int) -> PositionSample:
        """Return where the tool is at `t_us` [µs] since the start of the motion."""
        ...
