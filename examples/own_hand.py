"""A hand of your own: it feels its way around the ball of own_scene.py, and comes closer until it feels 1 N."""

import math


class Explorer:
    """Circle around the origin; move in while the force is small and out while it is large."""

    axes = 3
    duration_us = 10_000_000  # then the run ends; leave it out for a hand that never stops

    def __init__(self, force_n: float = 1.0, radius_m: float = 0.035) -> None:
        self.wanted_n = force_n
        self.radius_m = radius_m
        self.felt_n = 0.0

    def feel(self, _t_us: int, force_n: tuple[float, ...]) -> None:
        """Note the force [N] of all axes; called in every tick before `sample`. Leave it out if you need no force."""
        self.felt_n = math.hypot(*force_n)

    def sample(self, t_us: int) -> tuple[float, float, float]:
        """Return the position [m] at a time [µs] since the start; called 1000 times a second, so it must not wait."""
        self.radius_m -= 5e-6 * max(-1.0, self.wanted_n - self.felt_n)
        angle = 2e-6 * t_us
        return self.radius_m * math.cos(angle), self.radius_m * math.sin(angle), 0.0
