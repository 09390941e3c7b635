"""Position-based explicit force control: move the platform to where the learned finger gives the target force.

The sensed force does not drive the platform. It corrects the model of the finger (``finger.py``), its position and
stiffness, from which the displacement for the target follows. A step of the target is therefore answered by one motion
of the right size, whatever the finger, and there is no integral that could wind up. The model compares the force with
the position of the platform at the same moment, so a delay known to the host cannot make the loop oscillate; a finger
much stiffer than the model can (``margins.py`` computes the margin).

Further rules handle an insensitive sensor, a lost finger, and a sensor that is stuck, disconnected or failing.
"""

import math
from collections import deque
from typing import Final

from hapticnet.control.finger import LearnedFinger, compressed
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.hardware import STIFFEST_N_M
from hapticnet.samples import LARGEST_COMPONENT

ANSWER_N: Final = 0.06
"""Change of the sensed force [N] that shows a working sensor; several times its noise (about 10 mN per count)."""

SILENT_N: Final = 0.6
SILENT_FRACTION: Final = 0.2
"""Change of force (absolute [N] and relative) that the known finger must cause by a motion of the platform before an
unchanged reading counts as a fault. Above the sensor's hysteresis (10 %, data sheet), with margin for the model."""

PLAY_M: Final = 0.15e-3
"""Apparent motion [m] of the platform while the gears take up their play: 0.5° on a 12 mm arm is 0.1 mm."""

STEP_M: Final = 0.06e-3  # smallest step of the platform [m]: one third of a servo's deadband
SOFT_M_N: Final = 0.35e-3  # smallest compliance [m/N] assumed for a finger

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

RECENT: Final = 10  # number of control periods over which the platform must not have retreated


class SensorWatch:
    """Monitor of the sensed force while the platform touches the finger."""

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
        """Note that the target was released: forget a fall, so that the finger is approached like a new one."""
        self._fell_m = math.inf

    def check(
        self, touching: bool, sensed_n: float, stood_m: float, compliance_m_n: float, *, spread_n: float = 0.0
    ) -> str | None:
        """Return a description of a sensor fault, or None; call once per control period, before learning.

        If the sensor detects no touch, the finger may simply be gone. A stuck sensor corrupts the estimated compliance,
        so the one from the last change of the reading is used. `spread_n` is the range of the readings [N] within the
        period.
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


RESTING_N: Final = 1e-3  # largest change [N] of a resting target in a control period: 0.1 N/s


class ForceController:
    """Force control through a learned finger, with a sensor that does not detect light touch.

    A target below the sensor's threshold is set by the model alone. Without a target the platform waits just before the
    finger. With a target but no touch it goes to the last known position of the finger and then searches slowly over a
    short distance: it does not chase a withdrawn finger, and a silent sensor cannot drive the platform into the
    finger. The platform retracts if the sensor is stuck at full scale (at once), stuck at another value (once the
    platform has moved further than the finger could without a change of force) or oscillates (within a few periods;
    see ``force.py``). The controller tries again after the target has been released.
    """

    __slots__ = (
        "_before_m", "_largest_n", "_lead", "_most_n", "_moved_us", "_now_us", "_readings", "_resting", "_sensed_n",
        "_sensed_sum_n", "_settings", "_smallest_n", "_stood_m", "_stood_sum_m", "_target_n", "_touching", "_wanted_n",
        "_watch", "displacement_m", "fault", "finger",
    )  # fmt: skip

    def __init__(self, settings: ForceControlSettings) -> None:
        self._settings = settings
        self._most_n = settings.max_force_n - settings.headroom_n
        self._now_us: int | None = None
        self._moved_us = 0
        self.finger = LearnedFinger(settings.finger)
        self.reset()

    def reset(self) -> None:
        """Retract and forget the finger: after a device was lost, exchanged or removed."""
        self.fault: str | None = None  # reason why the platform stays retracted, or None
        self.finger.forget()
        self._watch = SensorWatch()
        self.displacement_m = 0.0  # last displacement [m] of the platform that was commanded
        self._before_m = 0.0
        self._target_n = self._wanted_n = self._sensed_n = self._stood_m = self._lead = 0.0
        self._resting = self._touching = False
        self._sensed_sum_n = 0.0
        self._stood_sum_m = 0.0
        self._readings = 0
        self._smallest_n, self._largest_n = math.inf, -math.inf

    def update(
        self, target_n: float, sensed_n: float, stood_m: float, now_us: int, *, ahead_n: float | None = None
    ) -> float:
        """Return the platform displacement [m] toward the finger.

        It changes once per control period, and at once when the force to press with falls by `early_n` or, if
        predicted, rises by as much.

        A target [N] that is not finite and positive counts as 0. The platform was at `stood_m` when the reading
        `sensed_n` was taken; a reading that is not finite or is out of range resets the controller, which retracts the
        platform. `ahead_n` is the target expected `foresight_s` from now, to which the platform already moves; None:
        unknown.
        """
        if not -LARGEST_COMPONENT < sensed_n < LARGEST_COMPONENT or not -1.0 < stood_m < 1.0:
            self.reset()
            self._now_us = now_us
            return 0.0
        self._sensed_sum_n += sensed_n
        if sensed_n < self._smallest_n:
            self._smallest_n = sensed_n
        if sensed_n > self._largest_n:
            self._largest_n = sensed_n
        self._stood_sum_m += stood_m
        self._readings += 1
        before_us = self._now_us
        target_n = self._allowed_n(target_n)
        wanted_n = target_n if ahead_n is None else self._allowed_n(ahead_n)
        if before_us is None or now_us < before_us:
            self._now_us = self._moved_us = now_us
            self._wanted_n = wanted_n
            return self.displacement_m
        elapsed_us = now_us - before_us
        if elapsed_us < self._settings.period_us:
            change_n = wanted_n - self._wanted_n
            if -change_n > self._settings.early_n or (ahead_n is not None and change_n > self._settings.early_n):
                self._move(target_n, wanted_n, now_us)
            return self.displacement_m
        self._now_us = now_us
        # After a late call, do not make up for the lost time in one step.
        elapsed_s = min(elapsed_us, 2 * self._settings.period_us) * 1e-6
        newest_n = sensed_n
        sensed_n, stood_m = self._sensed_sum_n / self._readings, self._stood_sum_m / self._readings
        self._sensed_sum_n = self._stood_sum_m = 0.0
        self._readings = 0
        self._learn(sensed_n, newest_n, stood_m, elapsed_s)
        self._sensed_n, self._stood_m = sensed_n, stood_m
        self._smallest_n, self._largest_n = math.inf, -math.inf
        self._lead = 0.0
        if ahead_n is None:
            before = compressed(self._target_n)
            self._lead = self._settings.lead_s / elapsed_s * (compressed(target_n) - before)
        self._resting = abs(target_n - self._target_n) <= RESTING_N
        self._move(target_n, wanted_n, now_us)
        self._target_n = target_n
        self._before_m = stood_m
        return self.displacement_m

    def _allowed_n(self, force_n: float) -> float:
        """Return a force [N] limited to the allowed range."""
        most_n = self._most_n
        if 0.0 <= force_n <= most_n:
            return force_n
        return most_n if most_n < force_n < math.inf else 0.0

    def _learn(self, sensed_n: float, newest_n: float, stood_m: float, elapsed_s: float) -> None:
        settings = self._settings
        # Half the threshold separates a sensor that conducts from one that does not, despite noise. The mean may mix
        # both states, so the newest reading counts as well.
        touching = min(sensed_n, newest_n) > 0.5 * settings.touch_n
        watch = self._watch
        spread_n = self._largest_n - self._smallest_n
        complaint = watch.check(touching, sensed_n, stood_m, self.finger.compliance_m_n, spread_n=spread_n)
        if self.fault is None:
            self.fault = complaint
        if self._touching and (watch.fallen or not touching):
            self.finger.recall()
        elif touching and not self._touching:
            self.finger.touch(stood_m, sensed_n)
        self._touching = touching
        if touching and not watch.fallen:
            self.finger.learn(stood_m, sensed_n, (stood_m - self._before_m) / elapsed_s, elapsed_s)

    def _move(self, target_n: float, wanted_n: float, now_us: int) -> None:
        """Set the displacement for a target [N], moving to where the finger is pressed with `wanted_n` [N]."""
        settings = self._settings
        elapsed_s = min(max(now_us - self._moved_us, 0), 2 * settings.period_us) * 1e-6
        self._moved_us = now_us
        self._wanted_n = wanted_n
        if target_n <= settings.release_n:
            self._watch.release()
        if self.fault is not None:
            self.displacement_m = 0.0
            if target_n <= settings.release_n and self._stood_m <= settings.clearance_m:
                self.reset()
        elif self._touching:
            self._press(target_n, wanted_n, elapsed_s)
        elif self.finger.felt:
            self._return(target_n, wanted_n, elapsed_s)
        elif target_n <= settings.release_n:
            self._go(0.0, elapsed_s)
        elif target_n >= settings.touch_n:
            self._go(min(self.displacement_m + settings.approach_speed_m_s * elapsed_s, settings.reach_m), elapsed_s)

    def _press(self, target_n: float, wanted_n: float, elapsed_s: float) -> None:
        settings, finger, sensed_n = self._settings, self.finger, self._sensed_n
        if wanted_n <= settings.release_n:
            self._go(finger.contact_m - settings.clearance_m, elapsed_s)
            return
        deadband_n = max(settings.deadband_n, settings.deadband_fraction * target_n)
        if self._resting and max(abs(sensed_n - target_n), abs(wanted_n - target_n)) <= deadband_n:
            return
        from_m = finger.displacement_m(sensed_n)
        if sensed_n - max(target_n, wanted_n) > max(settings.yield_n, settings.yield_fraction * target_n):
            from_m = min(from_m, self._stood_m)
        # A lead compensates the servos' lag; it never asks for more than the largest target.
        wanted = min(compressed(wanted_n) + self._lead, compressed(self._most_n))
        self._go(from_m + finger.cautious_m_n * (wanted - compressed(sensed_n)), elapsed_s)

    def _return(self, target_n: float, wanted_n: float, elapsed_s: float) -> None:
        settings, finger = self._settings, self.finger
        if wanted_n <= settings.release_n:
            self._go(finger.contact_m - settings.clearance_m, elapsed_s)
            return
        goal_m = finger.contact_m + finger.cautious_m_n * compressed(min(wanted_n, settings.search_n))
        if min(target_n, wanted_n) >= settings.touch_n and self._stood_m > goal_m - settings.clearance_m / 2.0:
            furthest_m = max(settings.search_m, finger.compliance_m_n * compressed(settings.search_n))
            further_m = self.displacement_m + settings.approach_speed_m_s * elapsed_s
            goal_m = min(max(goal_m, further_m), finger.contact_m + furthest_m)
        self._go(goal_m, elapsed_s)

    def _go(self, goal_m: float, elapsed_s: float) -> None:
        settings = self._settings
        # Above the largest force the platform only retreats. The play of the gears hides the retreat of a servo that
        # turned: if another servo advanced in its place, after a dip of the target, its step would add to the force.
        speed_m_s = settings.press_speed_m_s if self._sensed_n <= self._most_n else 0.0
        goal_m = min(goal_m, self.displacement_m + speed_m_s * elapsed_s, self._watch.furthest_m)
        self.displacement_m = max(0.0, min(goal_m, settings.travel_m))
