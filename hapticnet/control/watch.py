"""Detect a force sensor that is stuck, disconnected or failing."""

import math
from collections import deque
from typing import Final

from hapticnet.control.finger import compressed
from hapticnet.hardware import STIFFEST_N_M

ANSWER_N: Final = 0.06
"""Change of the sensed force [N] that shows a working sensor; several times its noise (about 10 mN per count)."""

SILENT_N: Final = 0.6
SILENT_FRACTION: Final = 0.2
"""Change of force (absolute [N] and relative) that the known finger must cause by a motion of the platform before an
unchanged reading counts as a fault. Above the sensor's hysteresis (10 %, data sheet), with margin for the model."""

PLAY_M: Final = 0.15e-3
"""Apparent motion [m] of the platform while the gears take up their play: 0.5° on a 12 mm arm is 0.1 mm."""

STEP_M: Final = 0.06e-3
"""Smallest step of the platform [m]: one third of a servo's deadband."""

SOFT_M_N: Final = 0.35e-3
"""Smallest compliance [m/N] assumed for a finger."""

JUMP_N: Final = 0.3
MOST_REVERSALS: Final = 3.0
REVERSAL_DECAY: Final = 0.25
"""Jump of the force [N] that counts as a reversal, number of reversals that count as a fault, and reduction of the
count per period without one. No finger causes a jump back and forth in successive control periods, because the servos
need a 20 ms frame and 20 to 40 ms of lag to reverse, or such a spread within a period while the platform hardly moves.
An open input picks up mains hum (50 or 60 Hz) or noise; slower drift or hum cannot be distinguished from a finger."""

FALL_N: Final = 0.5
FALL_FRACTION: Final = 0.3
"""Fall of the force, absolute [N] and relative, within a control period in which the platform does not retreat: either
the finger was withdrawn or the sensor lost contact in part. The two cannot be distinguished."""

RECENT: Final = 10
"""Number of control periods over which the platform must not have retreated."""


class SensorWatch:
    """Monitor of the sensed force while the platform touches the finger.

    Attributes
    ----------
    furthest_m
        Largest displacement [m] that the responses of the sensor justify; infinite if there is no objection.
    fallen
        Whether the force has fallen by itself since the last release: readings must not be learned from, and the
        platform must not go further than before.
    """

    __slots__ = ("_answered_m", "_compliance_m_n", "_fell_m", "_jump_n", "_newest_n", "_recent_m", "_reversals",
                 "_sensed_n", "_stood_m", "_watching")  # fmt: skip

    def __init__(self) -> None:
        self._watching = False
        self._sensed_n = 0.0
        self._stood_m = 0.0
        self._compliance_m_n = 0.0
        self._answered_m = math.inf
        self._newest_n = 0.0
        self._jump_n = 0.0
        self._reversals = 0.0
        self._recent_m: deque[float] = deque(maxlen=RECENT)
        self._fell_m = math.inf

    @property
    def fallen(self) -> bool:
        """Whether the force fell by itself."""
        return self._fell_m < math.inf

    @property
    def furthest_m(self) -> float:
        """The smaller of both limits."""
        return min(self._answered_m, self._fell_m)

    def release(self) -> None:
        """Note that the target was released: forget a fall, so that the finger is approached as new."""
        self._fell_m = math.inf

    def check(
        self, touching: bool, sensed_n: float, stood_m: float, compliance_m_n: float, *, spread_n: float = 0.0
    ) -> str | None:
        """Return a description of a sensor fault, or None; call once per control period, before learning.

        Parameters
        ----------
        touching
            Whether the sensor detects a touch; if not, the finger may simply be gone.
        sensed_n, stood_m
            Sensed force [N] and position of the platform [m].
        compliance_m_n
            Estimated compliance [m/N]. A stuck sensor corrupts the estimate, so the one from the last change of the
            reading is used.
        spread_n
            Range (largest less smallest) of the readings [N] within the period.
        """
        jump_n = sensed_n - self._newest_n
        reverses = abs(jump_n) > JUMP_N and abs(self._jump_n) > JUMP_N and jump_n * self._jump_n < 0.0
        moved_m = abs(stood_m - self._recent_m[-1]) if self._recent_m else 0.0
        reverses = reverses or spread_n > JUMP_N + STIFFEST_N_M * moved_m
        self._reversals = self._reversals + 1.0 if reverses else max(0.0, self._reversals - REVERSAL_DECAY)
        stood_before_m = max(self._recent_m, default=stood_m)
        falls = -jump_n > max(FALL_N, FALL_FRACTION * self._newest_n)
        if falls and stood_m > stood_before_m - PLAY_M:
            self._fell_m = min(self._fell_m, max(stood_before_m, stood_m))
        self._recent_m.append(stood_m)
        self._newest_n, self._jump_n = sensed_n, jump_n
        if self._reversals >= MOST_REVERSALS:
            largest_n = max(abs(jump_n), spread_n)
            return f"the force oscillates by {largest_n:.1f} N: is the sensor connected?"
        return self._silence(touching, sensed_n, stood_m, compliance_m_n)

    def _silence(self, touching: bool, sensed_n: float, stood_m: float, compliance_m_n: float) -> str | None:
        if not touching or not self._watching or abs(sensed_n - self._sensed_n) > ANSWER_N:
            self._watching = touching
            self._sensed_n = sensed_n
            self._stood_m = stood_m
            self._compliance_m_n = compliance_m_n
            # Slightly further than the limit for a fault; otherwise the platform would stop before reaching it.
            self._answered_m = stood_m + self._allowed_m(1.0) + 1.5 * STEP_M if touching else math.inf
            return None
        moved_m = stood_m - self._stood_m
        # While retreating, hysteresis hides a soft finger whose compliance may have been underestimated.
        if moved_m > self._allowed_m(1.0) or -moved_m > self._allowed_m(-1.0, compliance_m_n):
            return f"the force does not change while the platform moves: is the sensor stuck at {sensed_n:.1f} N?"
        return None

    def _allowed_m(self, direction: float, compliance_m_n: float = 0.0) -> float:
        """Return how far [m] the platform may move toward the finger (1) or away (-1) without a change of force."""
        known_m_n = max(compliance_m_n, self._compliance_m_n, SOFT_M_N)
        change_n = direction * max(SILENT_N, SILENT_FRACTION * self._sensed_n)
        compression = compressed(self._sensed_n + change_n) - compressed(self._sensed_n)
        return abs(compression) * known_m_n + PLAY_M
