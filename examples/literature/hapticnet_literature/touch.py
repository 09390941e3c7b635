"""What the tool at the slave has felt: its place, the scene's force there, and how stiff the scene seems."""

from typing import Final

from hapticnet.samples import Vector
from hapticnet.vectors import distance, dot, magnitude, minus, times

SMALLEST_MOVE_M: Final = 1e-7  # movement [m] from which a stiffness follows


class Touch:
    """The tool of a coupling at the slave; the scene is taken for a flat spring where it was last in contact."""

    def __init__(self, axes: int) -> None:
        self.position_m: Vector | None = None  # where the force was felt [m]; None before the first answer
        self.tool_m: Vector = ()  # where the tool was moved to [m]
        self.elapsed_s = 0.0  # time between the newest two commands [s]
        self._t_us: int | None = None
        self.force_n: Vector = (0.0,) * axes
        self.stiffness = 0.0  # |dF/dx| [N/m] of the newest movement in contact
        self.largest_stiffness = 0.0
        self._contact_m = self._contact_n = self.force_n  # newest place with a force

    def step(self, t_us: int) -> None:
        """Note the time [µs] of a command."""
        self.elapsed_s = 0.0 if self._t_us is None else max(1e-6 * (t_us - self._t_us), 0.0)
        self._t_us = t_us

    def feel(self, force_n: Vector) -> None:
        """Note the scene's force [N] at the place where the tool now is."""
        position_m = self.tool_m
        touches, touched = magnitude(force_n) > 0.0, magnitude(self.force_n) > 0.0
        move_m = 0.0 if self.position_m is None else distance(position_m, self.position_m)
        if move_m > SMALLEST_MOVE_M:
            stiffness = distance(force_n, self.force_n) / move_m
            self.largest_stiffness = max(stiffness, self.largest_stiffness)
            # Across the surface, the scene is at least as stiff as it seems.
            if (touches and touched) or stiffness > self.stiffness:
                self.stiffness = stiffness
        if touches:
            self._contact_m, self._contact_n = position_m, force_n
        self.position_m, self.force_n = position_m, force_n

    def expected(self, position_m: Vector, yields_m_per_n: float) -> Vector:
        """Return the force [N] at a place from which the tool would yield to it by `yields_m_per_n`."""
        size_n = magnitude(self._contact_n)
        if size_n == 0.0:
            return self._contact_n
        inward = times(self._contact_n, 1.0 / size_n)
        there_n = size_n + self.stiffness * dot(minus(position_m, self._contact_m), inward)
        return times(inward, max(there_n, 0.0) / (1.0 + self.stiffness * yields_m_per_n))
