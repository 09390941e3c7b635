"""Tells a force sensor that no longer answers from a finger that does."""

from typing import Final

ANSWER_N: Final = 0.06
"""A change of the sensed force [N] by which a sensor proves alive; several times its noise (about 10 mN a count)."""

SILENT_N: Final = 1.0
SILENT_FRACTION: Final = 0.25
"""A platform that moves so far that the known finger would change its force by this much, or by this share of it,
must be answered. Beyond the sensor's hysteresis (10 %, data sheet) with room for a finger known badly."""

PLAY_M: Final = 0.15e-3
"""Way [m] the platform may seem to move while the gears take up their play: 0.5° on a 12 mm arm is 0.1 mm."""

SOFT_M_N: Final = 0.35e-3
"""Compliance [m/N] below which a finger is not trusted to be that stiff."""


class StuckSensor:
    """Watches the sensed force while the platform moves on the finger."""

    __slots__ = ("_compliance_m_n", "_sensed_n", "_stood_m", "_watching")

    def __init__(self) -> None:
        self._watching = False
        self._sensed_n = 0.0
        self._stood_m = 0.0
        self._compliance_m_n = 0.0

    def noticed(self, touching: bool, sensed_n: float, stood_m: float, compliance_m_n: float) -> bool:
        """Tell whether the platform has gone further since the force last changed than the finger could follow.

        Parameters
        ----------
        touching
            Whether the sensor reads a touch at all; one that reads none may simply have lost the finger.
        sensed_n, stood_m
            The sensed force [N] and where the platform stood [m].
        compliance_m_n
            What is believed of the finger [m/N]; a stuck sensor spoils that belief, so the one from before counts too.
        """
        if not touching or not self._watching or abs(sensed_n - self._sensed_n) > ANSWER_N:
            self._watching = touching
            self._sensed_n = sensed_n
            self._stood_m = stood_m
            self._compliance_m_n = compliance_m_n
            return False
        known_m_n = max(compliance_m_n, self._compliance_m_n, SOFT_M_N)
        furthest_m = max(SILENT_N, SILENT_FRACTION * sensed_n) * known_m_n + PLAY_M
        return abs(stood_m - self._stood_m) > furthest_m
