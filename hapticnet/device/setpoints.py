"""Setpoints for the servos of a wired device, and an estimate of their motion.

A setpoint takes effect at the device's next servo frame, up to 20 ms later; readings report its sequence number.
"""

from dataclasses import replace
from typing import Final

from hapticnet.device.kinematics import Linkage, Pulses
from hapticnet.device.messages import TICKS_PER_US, Flag, Identity, SensorReading, Setpoint
from hapticnet.device.parts import Servo
from hapticnet.device.servos import Servos
from hapticnet.hardware import SERVO_FRAME_US

REPEAT_US: Final = SERVO_FRAME_US
"""Longest time between setpoints [µs]: one servo frame. The firmware retracts after 190 ms without one."""

LEAD_US: Final = 1_000
SLOT_US: Final = 2_500
"""Time [µs] from the firmware's choice of a setpoint to the first pulse of the frame, and between the starts of its
three pulses (firmware/avr/clock.c). A servo takes a pulse when it ends."""

DELAY_US: Final = 1_000 + LEAD_US + SLOT_US + 1_500
"""Time [µs] from a setpoint to the end of the second of the three pulses, of 1.5 ms, in a frame that begins as soon as
the setpoint is there; the first millisecond is the line's."""

JITTER_US: Final = 0.5
"""Largest error [µs] of a pulse width (0.44 in simavr). A step must exceed the servo's deadband by this margin, or the
servo takes it frames later."""

REMEMBERED: Final = 256
"""Number of setpoints kept until the device reports that it took them; at most one is sent per millisecond."""


class Setpoints:
    """Convert displacements to setpoints, and estimate the position of the platform from those that were taken.

    The device chose a setpoint up to one reading period before the first reading that reports it, so the estimate is
    late by half a period on average.

    Attributes
    ----------
    held_us
        The pulses [µs] of the device's last reported frame.
    """

    def __init__(self, linkage: Linkage, servo: Servo) -> None:
        self._linkage = replace(linkage, deadband_us=linkage.deadband_us + JITTER_US)
        self._estimate = Servos(linkage, replace(servo, backlash_deg=0.0))
        retracted_us = linkage.retracted_us
        self._retracted_us: Pulses = (retracted_us, retracted_us, retracted_us)
        self.held_us = self._sent_us = self._planned_us = self._retracted_us
        self._limits: list[tuple[int, int]] = []  # shortest and longest pulse of each servo [ticks]
        self._largest_step = 0  # [ticks]
        self._planned_for: tuple[float, Pulses] | None = None
        self._sent_at_us: int | None = None
        self._moved_us = 0
        self._under_way: list[tuple[int, int, float]] = []  # end of the pulse, servo, pulse
        self._sequence: int | None = None
        self._taken: int | None = None  # sequence number of the last setpoint taken
        self._remembered: list[tuple[int, Pulses] | None] = []

    @property
    def displacement_m(self) -> float:
        """Estimated position [m above retracted] of the platform at the last reading."""
        return self._estimate.displacement_m

    def start(self, identity: Identity, now_us: int) -> None:
        """Note that the device answered HELLO: it is retracted and has no setpoint."""
        self._limits = list(identity.pulse_limits)
        self._largest_step = identity.largest_step
        self.retract(now_us)
        self._sent_us = self._retracted_us
        self._planned_for = self._sent_at_us = self._sequence = self._taken = None
        self._remembered = [None] * REMEMBERED

    def retract(self, now_us: int) -> None:
        """Note that the device no longer receives setpoints: it retracts by itself within 220 ms."""
        self._move(now_us)
        self._hold(self._retracted_us, now_us)

    def follow(self, reading: SensorReading, now_us: int) -> None:
        """Advance time and apply the setpoint that a reading reports as taken."""
        self._move(now_us)
        applied = reading.applied_sequence
        if self._sequence is None:
            # Until the next frame, readings report a setpoint from before the HELLO; ignore it.
            self._sequence = applied
        if reading.flags & Flag.RETRACTED:
            self._hold(self._retracted_us, now_us)
            return
        remembered = self._remembered[applied % REMEMBERED]
        if remembered is None or remembered[0] != applied:
            return
        if not reading.flags & Flag.STEP_LIMITED:
            self._hold(remembered[1], now_us)
        elif applied != self._taken:
            # The frame took an older setpoint than this one; the next frame takes the rest.
            self._hold(self._stepped_us(remembered[1]), now_us)
        self._taken = applied

    def next(self, displacement_m: float, now_us: int) -> Setpoint | None:
        """Return the setpoint to send now for a displacement [m], or None if the last one is still valid."""
        if self._sequence is None:
            return None
        # A pulse within the deadband of a servo's goal was not taken, so it is not the servo's position.
        heading_us = self.held_us if self._under_way else self._estimate.heading_us
        if self._planned_for != (displacement_m, heading_us):
            self._planned_for = (displacement_m, heading_us)
            self._planned_us = self._allowed_us(self._linkage.pulses_us(displacement_m, heading_us))
        due = self._sent_at_us is None or not 0 <= now_us - self._sent_at_us < REPEAT_US
        if not due and self._planned_us == self._sent_us:
            return None
        self._sent_us = self._planned_us
        self._sent_at_us = now_us
        self._sequence = (self._sequence + 1) & 0xFFFF
        self._remembered[self._sequence % REMEMBERED] = (self._sequence, self._sent_us)
        one, two, three = self._sent_us
        return Setpoint(self._sequence, int(one * TICKS_PER_US), int(two * TICKS_PER_US), int(three * TICKS_PER_US))

    def _move(self, now_us: int) -> None:
        estimate = self._estimate
        while self._under_way and self._under_way[0][0] <= now_us:
            at_us, servo, pulse_us = self._under_way.pop(0)
            estimate.move(at_us - self._moved_us)
            estimate.take_one(servo, pulse_us)
            self._moved_us = max(self._moved_us, at_us)
        estimate.move(now_us - self._moved_us)
        self._moved_us = now_us

    def _hold(self, pulses_us: Pulses, now_us: int) -> None:
        if pulses_us != self.held_us:
            self.held_us = pulses_us
            # All pulses of the previous frame are over by now, so a jump of time delays but never loses them.
            for servo, pulse_us in enumerate(pulses_us):
                self._under_way.append((now_us + LEAD_US + servo * SLOT_US + round(pulse_us), servo, pulse_us))

    def _stepped_us(self, pulses_us: Pulses) -> Pulses:
        """Return pulses in whole ticks, none further toward the finger than the firmware's step limit allows."""
        step = self._largest_step
        stepped = []
        for pulse_us, held_us in zip(pulses_us, self.held_us, strict=True):
            held = round(held_us * TICKS_PER_US)
            stepped.append(min(round(pulse_us * TICKS_PER_US), held + step) / TICKS_PER_US)
        return (stepped[0], stepped[1], stepped[2])

    def _allowed_us(self, pulses_us: Pulses) -> Pulses:
        """Return pulses in whole ticks that the firmware neither refuses nor limits."""
        one, two, three = (
            min(max(pulse_us, shortest / TICKS_PER_US), longest / TICKS_PER_US)
            for pulse_us, (shortest, longest) in zip(self._stepped_us(pulses_us), self._limits, strict=True)
        )
        return (one, two, three)
