"""Position-based explicit force control: move the platform to where the learned finger gives the target force.

The sensed force does not drive the platform. It corrects the model of the finger (``finger.py``), its position and
stiffness, from which the displacement for the target follows. A step of the target is therefore answered by one motion
of the right size, whatever the finger, and there is no integral that could wind up. The model compares the force with
the position of the platform at the same moment, so a delay known to the host cannot make the loop oscillate; a finger
much stiffer than the model can (``margins.py`` computes the margin).

Further rules handle an insensitive sensor and a lost finger.
"""

import math
from typing import Final

from hapticnet.control.finger import LearnedFinger, compressed
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.watch import SensorWatch
from hapticnet.samples import LARGEST_COMPONENT

RESTING_N: Final = 1e-3
"""Largest change [N] of a resting target in a control period: 0.1 N/s."""


class ForceController:
    """Force control through a learned finger, with a sensor that does not detect light touch.

    A target below the sensor's threshold is set by the model alone. Without a target the platform waits just before the
    finger. With a target but no touch it goes to the last known position of the finger and then searches slowly and
    not far: it does not chase a withdrawn finger, and a sensor that falls silent cannot drive the platform into the
    finger. The platform retracts if the sensor is stuck at full scale (at once), stuck at another value (once the
    platform has moved further than the finger could without a change of force) or oscillates (within a few periods;
    see ``watch.py``). The controller tries again after the target has been released.

    Attributes
    ----------
    finger
        Model of the finger.
    displacement_m
        Last displacement [m] of the platform that was commanded.
    fault
        Reason why the platform stays retracted, or None.
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
        """Retract and forget the finger: after a device was lost, exchanged or taken off."""
        self.fault: str | None = None
        self.finger.forget()
        self._watch = SensorWatch()
        self.displacement_m = 0.0
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

        It changes once per control period, and at once when the force to press with falls by `early_n`, or, where it
        is predicted, rises by that.

        Parameters
        ----------
        target_n
            Target force [N]; a value that is not finite and positive counts as 0.
        sensed_n, stood_m
            The newest reading [N] and the position [m] of the platform when it was taken. A reading that is not finite
            or is out of range resets the controller, which retracts the platform.
        now_us
            Current time [µs].
        ahead_n
            Target [N] expected `foresight_s` from now, to which the platform already moves; None: unknown.
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
        """Return a force [N] limited to what is pressed with."""
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
