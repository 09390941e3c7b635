"""Limits of the force loop, and prior knowledge of the finger."""

from dataclasses import dataclass, field
from typing import Final

from hapticnet.checks import check_parameter
from hapticnet.control.finger import FingerSettings
from hapticnet.hardware import CONTACT_M, MAX_FORCE_N, SENSOR_THRESHOLD_N, SOFTEST_N_M, STIFFEST_N_M
from hapticnet.perception import PAPER_FLOOR_N

BEYOND_M: Final = 0.0011  # distance [m] past its contact at which the sensor detects a 0.3 N/mm finger


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceControlSettings:
    """Limits of the force loop, and prior knowledge of the finger."""

    # Prior knowledge of the finger and how fast it may change
    finger: FingerSettings = field(default_factory=FingerSettings)
    # Control period [µs]; readings within it are averaged. bench/measure/force_loop.py compares periods.
    period_us: int = 10_000
    travel_m: float = 0.015  # largest displacement [m] of the platform
    max_force_n: float = MAX_FORCE_N  # largest force [N] on the finger
    # Margin [N] between that and the largest target, for overshoot and for one servo step on a 3 N/mm finger (0.37 N
    # with the serial device)
    headroom_n: float = 0.4
    # Time [s] by which the platform leads a moving target, to compensate the servos' lag. Half the shortest lag typical
    # of the HS-55; a longer lead would make a 3 N/mm finger overshoot. Used where nothing predicts the target.
    lead_s: float = 0.01
    # Time [s] for which the target is to be predicted: the servos' lag. bench/measure/finger_limit.py compares times.
    foresight_s: float = 0.03
    early_n: float = 0.1  # change [N] of the wanted force that does not wait for the next control period
    press_speed_m_s: float = 0.06  # largest speed [m/s] toward the finger; the limit of the servos is 74 mm/s
    # Largest speed [m/s] while searching for the finger. The sensor reports a touch about 60 ms late, after 0.6 mm:
    # about 2 N on a 3 N/mm finger.
    approach_speed_m_s: float = 0.01
    touch_n: float = SENSOR_THRESHOLD_N  # smallest force [N] the sensor detects
    # Target [N] below which the finger is released. An assumption: half the JND's floor.
    release_n: float = 0.5 * PAPER_FLOOR_N
    # Distance [m] from the finger at which the platform then waits. An assumption, several times the gears' play.
    clearance_m: float = 0.0005
    # Largest error, as a force [N] or as a share of the target, at which the platform rests under a resting target.
    # Without this deadband, noise would slowly lower the platform through the sensor's hysteresis, where the reading
    # does not change. Several times the noise of an averaged reading; less than half a JND.
    deadband_n: float = 0.03
    deadband_fraction: float = 0.02
    # Excess of the sensed force over the target, as a force [N] and as a share of the target, at which the platform
    # retreats from its present position instead of waiting for the model
    yield_n: float = 0.3
    yield_fraction: float = 0.15
    # Distance [m] past the last contact to search for the finger, or the compression of the known finger at this force
    # [N] if that is further. Up to that force the platform does not slow down.
    search_m: float = 0.0005
    search_n: float = 1.0
    # Largest displacement [m] in the search for a finger not yet felt. An assumption for a finger 2 mm from the
    # retracted platform: far enough to detect a 0.3 N/mm finger; below 5 N on a 3 N/mm finger if the sensor is dead.
    reach_m: float = CONTACT_M + BEYOND_M

    def __post_init__(self) -> None:
        check_parameter("control period", self.period_us, 1, 1_000_000, "µs")
        check_parameter("travel", self.travel_m, 1e-4, 0.1, "m")
        check_parameter("largest force", self.max_force_n, 0.01, MAX_FORCE_N, "N")
        check_parameter("force headroom", self.headroom_n, 0.0, self.max_force_n, "N")
        check_parameter("lead", self.lead_s, 0.0, 0.1, "s")
        check_parameter("foresight", self.foresight_s, 0.0, 0.1, "s")
        check_parameter("early change", self.early_n, 0.0, 5.0, "N")
        check_parameter("press speed", self.press_speed_m_s, 1e-4, 1.0, "m/s")
        check_parameter("approach speed", self.approach_speed_m_s, 1e-4, 1.0, "m/s")
        check_parameter("touch force", self.touch_n, 0.0, 1.0, "N")
        check_parameter("release force", self.release_n, 0.0, 1.0, "N")
        check_parameter("clearance", self.clearance_m, 0.0, 0.1, "m")
        check_parameter("force deadband", self.deadband_n, 0.0, 1.0, "N")
        check_parameter("force deadband fraction", self.deadband_fraction, 0.0, 1.0)
        check_parameter("yield force", self.yield_n, 0.0, self.max_force_n, "N")
        check_parameter("yield fraction", self.yield_fraction, 0.0, 1.0)
        check_parameter("search", self.search_m, 0.0, 0.1, "m")
        check_parameter("search force", self.search_n, 0.0, self.max_force_n, "N")
        check_parameter("reach", self.reach_m, 0.0, 0.1, "m")


def for_known_finger(*, stiffness_n_m: float, contact_m: float) -> ForceControlSettings:
    """Return the settings for a finger of a stiffness [N/m] at a contact position [m], and a search just past that."""
    usual = FingerSettings()
    finger = FingerSettings(
        stiffness_n_m=min(max(stiffness_n_m, SOFTEST_N_M), STIFFEST_N_M), uncertainty=usual.largest_uncertainty
    )
    return ForceControlSettings(finger=finger, reach_m=max(0.0, contact_m) + BEYOND_M)
