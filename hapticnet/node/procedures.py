"""Procedures with a fingertip alone, without a slave: find the finger, step the target, measure the finger's stiffness.

A procedure is ticked like a node, in virtual or real time, and returns whether it is done.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hapticnet.checks import check_parameter
from hapticnet.control.finger import compressed
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.node.fingertip import FingerMet, FingerNotMet, Fingertip
from hapticnet.node.recording import Recording

STEP_COLUMNS: Final = ("t_us", "target_n", "sensed_n", "true_n", "stood_m", "sent_m")

LONGEST_ABSENCE_US: Final = 5_000_000
"""Longest wait [µs] for a device's first reading: a Nano's bootloader takes one to two seconds."""

LONGEST_LOSS_US: Final = 500_000  # longest time [µs] that a procedure continues without readings
LONGEST_SEARCH_US: Final = 10_000_000
"""Longest search [µs] for a finger: several times what the platform takes for its whole travel."""

TUNING_FORCES_N = (0.5, 0.8, 1.2, 1.6, 2.0)
"""Forces [N] at which a finger is measured, only increasing, to exclude the play of the gears and the hysteresis of the
sensor, and at most the paper's step."""

LEAST_SPAN_N: Final = 0.3  # smallest range of forces [N] from which a stiffness is computed
MEETING_N: Final = 0.5
MEETING_US: Final = 1_000_000
MEETING_WITHIN_US: Final = 5_000_000
RELEASE_US: Final = 300_000
"""Force [N] and duration [µs] of the press that finds a finger, longest search, and time to retreat from it."""

REST_US: Final = 1_200_000  # time [µs] for which each force is held; the mean of the second half is used


class Procedure:
    """Base of the procedures: waits for the device, then counts time from its first reading."""

    def __init__(self, fingertip: Fingertip) -> None:
        self.fingertip = fingertip
        self._absent_since_us: int | None = None
        self._start_us: int | None = None

    def _elapsed_us(self, now_us: int) -> int | None:
        """Return the time since the first reading, if any; UnavailableError after too long, or with a fault."""
        fingertip = self.fingertip
        if fingertip.controller.fault is not None:
            raise UnavailableError(fingertip.controller.fault)
        if fingertip.reading is not None:
            self._absent_since_us = None
            if self._start_us is None:
                self._start_us = now_us
        elif self._absent_since_us is None:
            self._absent_since_us = now_us
        elif now_us - self._absent_since_us > (LONGEST_ABSENCE_US if self._start_us is None else LONGEST_LOSS_US):
            raise UnavailableError(f"no readings from the device: {fingertip.device.status}")
        return None if self._start_us is None else now_us - self._start_us


class StepTest(Procedure):
    """A step of the target, recorded tick by tick. The loss of the device ends it, as it would distort the figures.

    `before_us`, `after_us`: time [µs] for which each is held; the finger must be found within the first.
    """

    def __init__(
        self, fingertip: Fingertip, *, from_n: float, to_n: float, before_us: int = 2_500_000, after_us: int = 2_000_000
    ) -> None:
        super().__init__(fingertip)
        largest_n = fingertip.largest_n
        check_parameter("start of the step", from_n, 0, largest_n, "N")
        check_parameter("end of the step", to_n, 0, largest_n, "N")
        if from_n == to_n:
            raise SettingsError(f"the step starts and ends at {from_n} N; the two forces must differ")
        # time, target, sensed force, true force (NaN if unknown), and measured and requested platform displacement
        self.recording = Recording(STEP_COLUMNS)
        self.step_us: int | None = None  # time of the step on the clock of the recording; None before it
        self._from_n = from_n
        self._to_n = to_n
        self._before_us = before_us
        self._after_us = after_us

    def tick(self, now_us: int) -> bool:
        """Do the next step of the procedure; return whether it is done."""
        elapsed_us = self._elapsed_us(now_us)
        if elapsed_us is not None and elapsed_us >= self._before_us and self.step_us is None:
            self.step_us = now_us
        target_n = self._from_n if self.step_us is None else self._to_n
        fingertip = self.fingertip
        fingertip.press(target_n, now_us)
        if elapsed_us is not None:
            if (reading := fingertip.reading) is None:
                raise UnavailableError(
                    f"the device was lost {elapsed_us / 1e6:.1f} s into the test: {fingertip.device.status}"
                )
            true_n = fingertip.device.contact_force_n
            forces_n = target_n, reading.force_n, math.nan if true_n is None else true_n
            self.recording.add((now_us, *forces_n, reading.displacement_m, fingertip.displacement_m))
        return self.step_us is not None and now_us >= self.step_us + self._after_us


@dataclass(frozen=True, slots=True)
class Met:
    """A found finger: mean force sensed at the end of the press [N], and platform displacement at contact [m]."""

    sensed_n: float
    contact_m: float


class Meeting(Procedure):
    """Find the finger, press it lightly, and wait just before contact.

    A platform that was never pressed against its finger is retracted and searches at 10 mm/s, so a first contact that
    lasts less than about 0.2 s would not be felt at all.

    `press_us`: duration [µs] of the press, once the finger is felt.
    """

    def __init__(self, fingertip: Fingertip, *, force_n: float = MEETING_N, press_us: int = MEETING_US) -> None:
        super().__init__(fingertip)
        check_parameter("force of the meeting", force_n, 0.2, fingertip.largest_n, "N")
        self._force_n = force_n
        self._press_us = press_us
        self._touched_us: int | None = None
        self._sum_n = 0.0
        self._readings = 0

    def tick(self, now_us: int) -> bool:
        """Do the next step of the procedure; return whether it is done."""
        fingertip = self.fingertip
        elapsed_us = self._elapsed_us(now_us)
        if self._touched_us is None:
            if fingertip.sensed_n > 0.5 * self._force_n:
                self._touched_us = now_us
            elif elapsed_us is not None and elapsed_us > MEETING_WITHIN_US:
                raise UnavailableError("the platform does not meet a finger: is one in the device, against its rest?")
            fingertip.press(self._force_n, now_us)
            return False
        since_us = now_us - self._touched_us
        fingertip.press(self._force_n if since_us < self._press_us else 0.0, now_us)
        if self._press_us // 2 <= since_us < self._press_us and fingertip.reading is not None:
            self._sum_n += fingertip.sensed_n
            self._readings += 1
        return since_us >= self._press_us + RELEASE_US

    def result(self) -> Met:
        """Return the result; raise UnavailableError if the press was not felt."""
        sensed_n = self._sum_n / self._readings if self._readings else 0.0
        if sensed_n < 0.5 * self._force_n:
            raise UnavailableError(
                f"the press of {self._force_n:g} N was felt as {sensed_n:.2f} N: did the finger move away?"
            )
        return Met(sensed_n, self.fingertip.controller.finger.contact_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """Properties of a finger."""

    stiffness_n_m: float  # tangent stiffness at 1 N [N/m]
    contact_m: float  # platform displacement at which it touches the finger [m]
    residual_m: float  # root mean square distance [m] of the points from the fitted fingertip law
    forces_n: tuple[float, ...]  # the points: sensed force [N] and displacement [m]
    displacements_m: tuple[float, ...]


class Tuning(Procedure):
    """Search the whole travel of the platform for the finger, press it with a few rising forces, and retract."""

    def __init__(self, fingertip: Fingertip, *, max_force_n: float = TUNING_FORCES_N[-1]) -> None:
        super().__init__(fingertip)
        self._forces_n = [force_n for force_n in TUNING_FORCES_N if force_n <= max_force_n]
        if not max_force_n <= fingertip.largest_n:
            raise SettingsError(f"tuning force is {max_force_n} N; it must be at most {fingertip.largest_n:g} N")
        if len(self._forces_n) < 3:
            raise SettingsError(f"tuning force is {max_force_n} N; it must be at least {TUNING_FORCES_N[2]:g} N")
        self._touched_us: int | None = None
        self._sums = np.zeros((len(self._forces_n), 3))

    def tick(self, now_us: int) -> bool:
        """Do the next step of the procedure; return whether it is done."""
        fingertip = self.fingertip
        elapsed_us = self._elapsed_us(now_us)
        if self._touched_us is None:
            if fingertip.controller.finger.felt:
                self._touched_us = now_us
            elif elapsed_us is not None and elapsed_us > LONGEST_SEARCH_US:
                raise UnavailableError("no finger felt over the whole travel of the platform: is one in the device?")
            fingertip.press(self._forces_n[0], now_us)
            return False
        since_us = now_us - self._touched_us
        index = since_us // REST_US
        if index >= len(self._forces_n):
            fingertip.press(0.0, now_us)
            return since_us >= len(self._forces_n) * REST_US + REST_US // 4
        fingertip.press(self._forces_n[index], now_us)
        if since_us % REST_US >= REST_US // 2 and (reading := fingertip.reading) is not None:
            self._sums[index] += (1.0, reading.force_n, reading.displacement_m)
        return False

    def result(self) -> Tuned:
        """Return the properties of the finger; raise UnavailableError if the measurement does not fit a finger."""
        if not self._sums[:, 0].all():
            raise UnavailableError("the device was lost while the finger was being pressed; try again")
        forces_n, displacements_m = (self._sums[:, 1:] / self._sums[:, :1]).T
        compressions = np.array([compressed(float(force_n)) for force_n in forces_n])
        if np.ptp(forces_n) < LEAST_SPAN_N:
            raise UnavailableError(
                f"the finger was pressed with {forces_n.min():.2f} to {forces_n.max():.2f} N only: is one in the "
                "device, and does the sensor feel it?"
            )
        compliance_m_n, contact_m = (float(value) for value in np.polyfit(compressions, displacements_m, 1))
        if not compliance_m_n > 0.0:
            raise UnavailableError("the force does not rise while the platform advances: is a finger in the device?")
        residuals_m = displacements_m - contact_m - compliance_m_n * compressions
        return Tuned(
            stiffness_n_m=1.0 / compliance_m_n,
            contact_m=contact_m,
            residual_m=float(np.sqrt(np.mean(residuals_m**2))),
            forces_n=tuple(forces_n.tolist()),
            displacements_m=tuple(displacements_m.tolist()),
        )


FIRST_TOUCH_N: Final = 1.0
FIRST_TOUCH_US: Final = 500_000
"""Force [N] and duration [µs] of the first touch. The rise of the force shows the stiffness: less force would leave it
uncertain. A fifth of the largest force, and half of the tuning force."""


class FirstTouch(Meeting):
    """The first touch of a finger, before a master asks for a session.

    A platform that was never pressed against its finger is retracted and does not know where it is or how stiff. The
    first force of a session would then be felt late: the platform searches at 10 mm/s, and presses cautiously.
    """

    def __init__(self, fingertip: Fingertip) -> None:
        super().__init__(fingertip, force_n=min(FIRST_TOUCH_N, fingertip.largest_n), press_us=FIRST_TOUCH_US)

    def outcome(self, now_us: int) -> FingerMet | FingerNotMet | None:
        """Press one step; return the result once it is finished. The device may raise anything."""
        try:
            if not self.tick(now_us):
                return None
            stiffness_n_m = 1.0 / self.fingertip.controller.finger.compliance_m_n
            return FingerMet(self.result().contact_m, stiffness_n_m)
        except UnavailableError as error:
            return FingerNotMet(str(error))
