"""Tells a force sensor that no longer answers, or answers to nothing, from one that feels a finger."""

import math
from collections import deque
from typing import Final

from hapticnet.control.finger import compressed
from hapticnet.hardware import STIFFEST_N_M

ANSWER_N: Final = 0.06
"""A change of the sensed force [N] by which a sensor proves alive; several times its noise (about 10 mN a count)."""

SILENT_N: Final = 0.6
SILENT_FRACTION: Final = 0.2
"""A platform that moves so far that the known finger would change its force by this much, or by this share of it,
must be answered. Beyond the sensor's hysteresis (10 %, data sheet) with room for a finger known badly."""

PLAY_M: Final = 0.15e-3
"""Way [m] the platform may seem to move while the gears take up their play: 0.5° on a 12 mm arm is 0.1 mm."""

STEP_M: Final = 0.06e-3
"""The finest step of the platform [m]: one servo's deadband, divided by three."""

SOFT_M_N: Final = 0.35e-3
"""Compliance [m/N] below which a finger is not trusted to be that stiff."""

LEAP_N: Final = 0.3
MOST_REVERSALS: Final = 3.0
FORGIVEN: Final = 0.25
"""A force that leaps by so much forth and back from one control period to the next is no finger's: the servos take
20 ms a frame and 20 to 40 ms of lag to turn round. Nor does one spread so far within a period while the platform hardly
moves. So many such periods are a fault; each without makes up for a part of one. An open input hums with the mains, 50
or 60 Hz, or is noise; what drifts or hums more slowly cannot be told from a finger."""

FALL_N: Final = 0.5
FALL_FRACTION: Final = 0.3
"""A force that falls by so much, and by this share, within a control period while the platform does not retreat: the
finger was drawn away, or the sensor has lost a part of what it feels. The two cannot be told apart."""

RECENT: Final = 10
"""Control periods in which a platform that stands where it stood counts as not retreating."""


class SensorWatch:
    """Watches the sensed force while the platform is on the finger.

    Attributes
    ----------
    furthest_m
        Where the platform may be sent [m], by what the sensor has answered so far; infinite where nothing is known
        against it.
    fallen
        Whether the force fell by itself since the last time it was let go: what the sensor says is not to be learned
        from, and the platform goes no further than it stood before.
    """

    __slots__ = ("_answered_m", "_compliance_m_n", "_fell_m", "_leap_n", "_newest_n", "_recent_m", "_reversals",
                 "_sensed_n", "_stood_m", "_watching")  # fmt: skip

    def __init__(self) -> None:
        self._watching = False
        self._sensed_n = 0.0
        self._stood_m = 0.0
        self._compliance_m_n = 0.0
        self._answered_m = math.inf
        self._newest_n = 0.0
        self._leap_n = 0.0
        self._reversals = 0.0
        self._recent_m: deque[float] = deque(maxlen=RECENT)
        self._fell_m = math.inf

    @property
    def fallen(self) -> bool:
        """Whether the force fell by itself."""
        return self._fell_m < math.inf

    @property
    def furthest_m(self) -> float:
        """The nearer of both limits."""
        return min(self._answered_m, self._fell_m)

    def let_go(self) -> None:
        """Note that nothing is asked for: whatever fell is forgiven, and the finger is met anew."""
        self._fell_m = math.inf

    def notice(
        self, touching: bool, sensed_n: float, stood_m: float, compliance_m_n: float, *, spread_n: float = 0.0
    ) -> str | None:
        """Return what is wrong with the sensor, or None; called once a control period, before anything is learned.

        Parameters
        ----------
        touching
            Whether the sensor reads a touch at all; one that reads none may simply have lost the finger.
        sensed_n, stood_m
            The sensed force [N] and where the platform stood [m].
        compliance_m_n
            What is believed of the finger [m/N]. A stuck sensor spoils that belief: what counts is the one from when it
            answered last.
        spread_n
            Largest less smallest reading [N] within the period.
        """
        leap_n = sensed_n - self._newest_n
        reverses = abs(leap_n) > LEAP_N and abs(self._leap_n) > LEAP_N and leap_n * self._leap_n < 0.0
        moved_m = abs(stood_m - self._recent_m[-1]) if self._recent_m else 0.0
        reverses = reverses or spread_n > LEAP_N + STIFFEST_N_M * moved_m
        self._reversals = self._reversals + 1.0 if reverses else max(0.0, self._reversals - FORGIVEN)
        stood_before_m = max(self._recent_m, default=stood_m)
        falls = -leap_n > max(FALL_N, FALL_FRACTION * self._newest_n)
        if falls and stood_m > stood_before_m - PLAY_M:
            self._fell_m = min(self._fell_m, max(stood_before_m, stood_m))
        self._recent_m.append(stood_m)
        self._newest_n, self._leap_n = sensed_n, leap_n
        if self._reversals >= MOST_REVERSALS:
            leapt_n = max(abs(leap_n), spread_n)
            return f"the force leaps by {leapt_n:.1f} N forth and back: is the sensor connected?"
        return self._silence(touching, sensed_n, stood_m, compliance_m_n)

    def _silence(self, touching: bool, sensed_n: float, stood_m: float, compliance_m_n: float) -> str | None:
        if not touching or not self._watching or abs(sensed_n - self._sensed_n) > ANSWER_N:
            self._watching = touching
            self._sensed_n = sensed_n
            self._stood_m = stood_m
            self._compliance_m_n = compliance_m_n
            # A little further than what is a fault, or the platform would stand still and never be one.
            self._answered_m = stood_m + self._way_m(1.0) + 1.5 * STEP_M if touching else math.inf
            return None
        way_m = stood_m - self._stood_m
        # On the way back the sensor's hysteresis hides a soft finger, which may have been believed stiff before.
        if way_m > self._way_m(1.0) or -way_m > self._way_m(-1.0, compliance_m_n):
            return f"the force does not change while the platform moves: is the sensor stuck at {sensed_n:.1f} N?"
        return None

    def _way_m(self, direction: float, compliance_m_n: float = 0.0) -> float:
        """Return how far [m] the platform may go toward the finger (1) or away (-1) without an answer."""
        known_m_n = max(compliance_m_n, self._compliance_m_n, SOFT_M_N)
        change_n = direction * max(SILENT_N, SILENT_FRACTION * self._sensed_n)
        way = compressed(self._sensed_n + change_n) - compressed(self._sensed_n)
        return abs(way) * known_m_n + PLAY_M
