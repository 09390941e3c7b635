"""A fingertip device of your own. This one is simulated: a motor moves a platform against a finger of 1 N/mm.

    hapticnet master --device examples/own_device.py:Platform:port=/dev/ttyUSB0
    hapticnet device step examples/own_device.py:Platform

hapticnet's force loop moves the platform until your sensor reads the force.
"""


class Platform:
    """Replace the two marked lines by your motor and your sensor."""

    travel_m = 0.005
    max_force_n = 5.0

    def __init__(self, port: str = "simulated") -> None:
        self.description = f"platform on {port}"
        self._at_m = 0.0
        self._now_us = 0

    def exchange(self, displacement_m: float, now_us: int) -> float | None:
        """Move to a displacement [m] (0: retracted) and return the force sensed [N], or None if there is no reading.

        Called in every tick: write to your port, return the newest value that has arrived, and wait for nothing.
        """
        elapsed_us, self._now_us = min(now_us - self._now_us, 20_000), now_us
        self._at_m += (displacement_m - self._at_m) * elapsed_us / (elapsed_us + 10_000)  # your motor
        return max(0.0, 1000.0 * (self._at_m - 0.002))  # your sensor

    def close(self) -> None:
        """Switch off; called at the end, after a last displacement of 0."""
        self._at_m = 0.0
