"""Position-based explicit force control: the platform goes toward the finger until the sensor reads the target.

The loop is a PI controller with setpoint weighting, so that a leap of the target strikes no blow. It is in
incremental form, so its integral cannot wind up: what was not allowed to be added to the displacement was never
added. Around it stand the rules that a deaf sensor and a coarse servo ask for.
"""

import math
from dataclasses import dataclass

from hapticnet.control.limits import DEVICE_MAX_FORCE_N
from hapticnet.errors import SettingsError
from hapticnet.samples import LARGEST_COMPONENT


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceControlSettings:
    """Gains and limits of the force loop.

    The gains were swept on the simulated device, hysteresis, noise, backlash and threshold on. Their ratio is the
    servo's lag, which it cancels; what remains is an integrator behind some 25 ms of dead time. The integral gain is
    as high as a 3 N/mm finger and servos of 20 to 40 ms lag allow without a force above 5 N or hunting.

    Attributes
    ----------
    proportional_m_per_n
        Displacement [m] per newton of error.
    integral_m_per_n_s
        Speed [m/s] per newton of error.
    target_weight
        Share of the target in the proportional part (0 to 1). At 1 a step of the target throws a 3 N/mm finger beyond
        5 N; at 0 a moving target is followed a fifth worse.
    stiffening_per_n
        How much [1/N] the gains fall with sensed force above 1 N: by ``1 / (1 + stiffening_per_n · (force − 1 N))``,
        because a finger stiffens as it is pressed. Two thirds of what the simulated finger does: the whole of it
        would cost rise time, none would leave a 3 N/mm finger at 3.5 N no room for 10 ms of extra delay.
    deadband_n
        Error [N] the integral leaves alone. One step of one HS-55 (8 µs on a 12 mm arm) moves the platform 0.056 mm,
        0.07 N on a 1 N/mm finger at 2 N: half of that is the finest the loop can set.
    deadband_fraction
        The same as a fraction of the target (dimensionless); the larger holds. 2 % is less than half a JND.
    period_us
        Control period [µs]; readings in between are averaged.
    travel_m
        How far [m] the platform may go.
    max_force_n
        Largest force [N] the finger may feel.
    headroom_n
        How far [N] below that the loop aims at most, room for its overshoot; 6 % of 5 N, about one JND.
    press_speed_m_s
        Fastest motion [m/s] toward a touched finger. Lower than the servos' 74 mm/s, so that the displacement asked
        for does not run ahead of them and a stiff finger is not struck.
    retract_speed_m_s
        Fastest motion [m/s] away from it while regulating.
    approach_speed_m_s
        Fastest motion [m/s] while nothing is touched. The sensor reports a touch some 60 ms late: 0.6 mm, some 2 N
        on a 3 N/mm finger.
    touch_n
        Smallest force [N] the sensor can tell; 0.2 N of the FSR 400 series, data sheet.
    clearance_m
        How far [m] before the point of touch the platform waits for a target it cannot sense. An assumption.
    search_m
        How far [m] beyond the last point of touch it may look for the finger. An assumption.
    reach_m
        How far [m] it may look for the finger at first. An assumption for a finger 2 mm from the retracted platform:
        just far enough to feel a 0.3 N/mm finger, and below 5 N on a 3 N/mm one should the sensor be dead.

    Raises
    ------
    SettingsError
        When a value is not finite or out of its range.
    """

    proportional_m_per_n: float = 0.4e-3
    integral_m_per_n_s: float = 14e-3
    target_weight: float = 0.5
    stiffening_per_n: float = 0.2
    deadband_n: float = 0.04
    deadband_fraction: float = 0.02
    period_us: int = 10_000
    travel_m: float = 0.015
    max_force_n: float = DEVICE_MAX_FORCE_N
    headroom_n: float = 0.3
    press_speed_m_s: float = 0.015
    retract_speed_m_s: float = 0.06
    approach_speed_m_s: float = 0.01
    touch_n: float = 0.2
    clearance_m: float = 0.001
    search_m: float = 0.0005
    reach_m: float = 0.0031

    def __post_init__(self) -> None:
        for name, value, smallest, largest in (
            ("proportional gain [m/N]", self.proportional_m_per_n, 0.0, 0.1),
            ("integral gain [m/(N·s)]", self.integral_m_per_n_s, 0.0, 10.0),
            ("target weight", self.target_weight, 0.0, 1.0),
            ("stiffening [1/N]", self.stiffening_per_n, 0.0, 10.0),
            ("force deadband [N]", self.deadband_n, 0.0, 1.0),
            ("force deadband fraction", self.deadband_fraction, 0.0, 1.0),
            ("control period [µs]", self.period_us, 1, 1_000_000),
            ("travel [m]", self.travel_m, 1e-4, 0.1),
            ("largest force [N]", self.max_force_n, 0.01, DEVICE_MAX_FORCE_N),
            ("force headroom [N]", self.headroom_n, 0.0, self.max_force_n),
            ("press speed [m/s]", self.press_speed_m_s, 1e-4, 1.0),
            ("retract speed [m/s]", self.retract_speed_m_s, 1e-4, 1.0),
            ("approach speed [m/s]", self.approach_speed_m_s, 1e-4, 1.0),
            ("touch force [N]", self.touch_n, 0.0, 1.0),
            ("clearance [m]", self.clearance_m, 0.0, 0.1),
            ("search [m]", self.search_m, 0.0, 0.1),
            ("reach [m]", self.reach_m, 0.0, 0.1),
        ):
            if not smallest <= value <= largest:
                raise SettingsError(f"{name} is {value}; it must be between {smallest:g} and {largest:g}")


class ForceController:
    """PI force control with anti-windup and a deadband, over a sensor that is deaf to light touch.

    Where the error is smaller than the deadband the integral rests. A servo's steps can be coarser than that on a
    stiff finger; each time the error swings from one side to the other and back at the same target the deadband
    doubles, up to fourfold, until the target changes: the loop comes to rest instead of hunting.

    A target below `touch_n` cannot be controlled, because the sensor reads nothing there. The platform then goes back
    to just before the point of touch and stays: the finger feels nothing, and the loop neither winds up nor hunts.

    With a target but no touch the platform looks for the finger, slowly, and no further than `search_m` beyond where
    it last felt it. So a finger withdrawn is not chased, and a sensor that falls silent while pressing cannot drive
    the platform into the finger. A sensor stuck at full scale retracts. One stuck in between cannot be told from a
    soft finger; only the travel bounds it.
    """

    __slots__ = (
        "_direction", "_displacement_m", "_furthest_m", "_now_us", "_readings", "_sensed_sum_n", "_settings",
        "_steady_n", "_swings", "_touching", "_weighted_n",
    )  # fmt: skip

    def __init__(self, settings: ForceControlSettings) -> None:
        self._settings = settings
        self._now_us: int | None = None
        self.reset()

    def reset(self) -> None:
        """Retract, and look for the finger anew: after a device was lost, changed or taken off."""
        self._displacement_m = 0.0
        self._furthest_m = min(self._settings.reach_m, self._settings.travel_m)
        self._touching = False
        self._weighted_n = 0.0
        self._steady_n = 0.0
        self._direction = 0.0
        self._swings = 0
        self._sensed_sum_n = 0.0
        self._readings = 0

    def update(self, target_n: float, sensed_n: float, now_us: int) -> float:
        """Return the platform displacement [m] toward the finger; changes once a control period.

        A reading that is no number, or absurd, retracts at once and starts anew. A target that is not finite and
        positive asks for no force.
        """
        if not -LARGEST_COMPONENT < sensed_n < LARGEST_COMPONENT:
            self.reset()
            self._now_us = now_us
            return 0.0
        self._sensed_sum_n += sensed_n
        self._readings += 1
        settings = self._settings
        before_us = self._now_us
        if before_us is None or now_us < before_us:
            self._now_us = now_us
            return self._displacement_m
        elapsed_us = now_us - before_us
        if elapsed_us < settings.period_us:
            return self._displacement_m
        self._now_us = now_us
        # A late call must not make up for lost time with a leap.
        elapsed_s = min(elapsed_us, 2 * settings.period_us) * 1e-6
        mean_n = self._sensed_sum_n / self._readings
        self._sensed_sum_n = 0.0
        self._readings = 0
        if not 0.0 <= target_n < math.inf:
            target_n = 0.0
        target_n = min(target_n, settings.max_force_n - settings.headroom_n)
        self._control(target_n, mean_n, elapsed_s)
        return self._displacement_m

    def _control(self, target_n: float, sensed_n: float, elapsed_s: float) -> None:
        settings = self._settings
        weighted_n = settings.target_weight * target_n - sensed_n
        change_n = weighted_n - self._weighted_n
        self._weighted_n = weighted_n
        # Half the threshold tells a sensor that conducts from one that does not, through its noise.
        touching = sensed_n > 0.5 * settings.touch_n
        if touching and not self._touching:
            self._furthest_m = self._displacement_m + settings.search_m
        self._touching = touching
        if target_n < settings.touch_n:
            touch_m = self._furthest_m - settings.search_m
            waiting_m = max(0.0, touch_m - settings.clearance_m)
            self._displacement_m = min(self._displacement_m, waiting_m)
        elif touching:
            self._regulate(target_n, sensed_n, change_n, elapsed_s)
        else:
            self._approach(target_n - sensed_n, elapsed_s)

    def _regulate(self, target_n: float, sensed_n: float, change_n: float, elapsed_s: float) -> None:
        settings = self._settings
        error_n = target_n - sensed_n
        softening = 1.0 / (1.0 + settings.stiffening_per_n * max(0.0, sensed_n - 1.0))
        motion_m = softening * settings.proportional_m_per_n * change_n
        if abs(error_n) > self._deadband_n(target_n, error_n):
            motion_m += softening * settings.integral_m_per_n_s * error_n * elapsed_s
        else:
            # At rest on the finger, so it cannot be further away than this.
            self._furthest_m = min(self._furthest_m, self._displacement_m + settings.search_m)
        motion_m = max(-settings.retract_speed_m_s * elapsed_s, min(motion_m, settings.press_speed_m_s * elapsed_s))
        self._displacement_m = max(0.0, min(self._displacement_m + motion_m, settings.travel_m))

    def _deadband_n(self, target_n: float, error_n: float) -> float:
        """Return the deadband [N], counting how often the error has swung through it at this target."""
        settings = self._settings
        base_n = max(settings.deadband_n, settings.deadband_fraction * target_n)
        if abs(target_n - self._steady_n) > base_n:
            self._steady_n = target_n
            self._direction = 0.0
            self._swings = 0
        # The first swing is the step response's own overshoot.
        deadband_n = base_n * (1, 1, 2, 4)[self._swings]
        if abs(error_n) > deadband_n:
            direction = math.copysign(1.0, error_n)
            if direction == -self._direction:
                self._swings = min(self._swings + 1, 3)
            self._direction = direction
        return deadband_n

    def _approach(self, error_n: float, elapsed_s: float) -> None:
        settings = self._settings
        speed_m_s = min(settings.approach_speed_m_s, settings.integral_m_per_n_s * error_n)
        furthest_m = min(self._furthest_m, settings.travel_m)
        self._displacement_m = min(self._displacement_m + speed_m_s * elapsed_s, furthest_m)
