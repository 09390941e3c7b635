"""The interface of an operator."""

from typing import Protocol

from hapticnet.samples import PositionSample, Vector


class Operator(Protocol):
    """A source of tool positions: a script, a recording, a person, or a program.

    An operator that is to know the force also defines ``feel(t_us: int, force_n: Vector) -> None``. It is called in
    every tick before `sample`, with the held force [N] of all axes.
    """

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


class FeelingOperator(Operator, Protocol):
    """An operator that is told the force."""

    def feel(self, t_us: int, force_n: Vector) -> None:
        """Take the force [N] that is held at `t_us` [µs] from the start of the motion."""
        ...
