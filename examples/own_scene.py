"""A scene of your own: a soft ball that is touched from all sides, with three axes.

Serve it, and explore it with the hand of own_hand.py:

    hapticnet slave --scene examples/own_scene.py:Ball:radius_m=0.03
    hapticnet master --operator examples/own_hand.py:Explorer --device none --predicted
"""

import math

import hapticnet as hn


class Ball:
    """A ball around the origin that pushes the tool out.

    As everywhere in hapticnet, a force is positive where it pushes against its axis, toward smaller coordinates.
    """

    axes = 3
    name = "ball"

    def __init__(self, radius_m: float = 0.02, stiffness_n_per_m: float = 300.0) -> None:
        self.radius_m = radius_m
        self.stiffness_n_per_m = stiffness_n_per_m

    def step(self, sample: hn.PositionSample) -> tuple[float, ...]:
        """Return the force [N] at a position [m]; called for every position, so it must not wait."""
        distance_m = math.hypot(*sample.position_m)
        if not 0.0 < distance_m < self.radius_m:
            return (0.0, 0.0, 0.0)
        force_n = self.stiffness_n_per_m * (self.radius_m - distance_m)
        return tuple(-force_n * x / distance_m for x in sample.position_m)

    def copy(self) -> "Ball":
        """Return a ball in the same state, for masters that ask for a prediction of the hand (``--predicted``)."""
        return Ball(self.radius_m, self.stiffness_n_per_m)
