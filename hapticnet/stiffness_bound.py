"""The stiffness bound: how far the force may change at positions near the tool."""

from typing import Final, NamedTuple

from hapticnet.samples import Vector

LONGEST_SILENCE_US: Final = 100_000
"""Longest time [µs] between two positions of a master that sends them only when they matter."""


SOFTEST_COVERED: Final = 0.6
"""A stiffness bound also serves for one that is softer by up to this factor; a much softer one is worth sending."""


class StiffnessBound(NamedTuple):
    """A box of positions, and how much the force may change within it.

    While the tool stays in the box, the forces at two positions that are d apart, at velocities that differ by w,
    differ by at most ``stiffness · d + damping · w``, and stepping the scene at any position in the box causes no
    lasting change. A surface, or the depth at which one breaks, is therefore a side of the box.
    """

    stiffness_n_per_m: float  # largest change of the force per distance [N/m], 0 or above
    damping_n_s_per_m: float  # largest change of the force per velocity [N·s/m], 0 or above
    # Sides of the box [m], one number per axis
    low_m: Vector
    high_m: Vector
    # By how much the stiffness grows with the force [1/m], 0 or above: where the force is F without its damping, the
    # stiffness is at most ``stiffness + stiffening · F``.
    stiffening_per_m: float = 0.0

    def contains(self, position_m: Vector) -> bool:
        """Return whether a position is in the box."""
        if len(position_m) == 1:  # the common case, kept short: asked at every tick
            return self.low_m[0] <= position_m[0] <= self.high_m[0]
        return all(
            low <= component <= high for low, component, high in zip(self.low_m, position_m, self.high_m, strict=True)
        )

    def nearest(self, position_m: Vector) -> Vector:
        """Return the position in the box that is nearest to a position."""
        if len(position_m) == 1:
            return (min(max(position_m[0], self.low_m[0]), self.high_m[0]),)
        return tuple(
            min(max(component, low), high)
            for low, component, high in zip(self.low_m, position_m, self.high_m, strict=True)
        )

    def covers(self, newer: "StiffnessBound", position_m: Vector) -> bool:
        """Return whether this bound still serves a master, with the tool at a position [m]."""
        if newer is self:
            return True
        # The bound must still be true here.
        return (
            self.contains(position_m)
            and SOFTEST_COVERED * self.stiffness_n_per_m <= newer.stiffness_n_per_m <= self.stiffness_n_per_m
            and newer.damping_n_s_per_m <= self.damping_n_s_per_m
            and newer.stiffening_per_m <= self.stiffening_per_m
            and all(mine >= theirs for mine, theirs in zip(self.low_m, newer.low_m, strict=True))
            and all(mine <= theirs for mine, theirs in zip(self.high_m, newer.high_m, strict=True))
        )
