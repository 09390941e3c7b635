"""The host's end of the serial line to a fingertip device, sans-I/O: bytes in, bytes out, time passed in.

::

    absent ── opened ──► greeting ── identity ──► starting ── reading ──► streaming
       ▲                    │  ▲                                              │
       └── closed (any) ──  │  └──────── reset, or silent for 50 ms ──────────┘
                             └── other protocol version ──► refused

A setpoint takes effect at the next servo frame of the device, up to 20 ms later; readings report its sequence number.
Readings exist only in the streaming state. Otherwise the device receives no setpoints and retracts by itself.
"""

from dataclasses import replace
from enum import Enum
from typing import Final

from hapticnet.device.base import Device, Reading, presses
from hapticnet.device.calibration import Calibration
from hapticnet.device.messages import (
    ADC_FRACTION,
    LAYOUTS,
    RESET_CAUSES,
    TICKS_PER_US,
    Deframer,
    Flag,
    Hello,
    Identity,
    SensorReading,
    Setpoint,
    Stream,
    StreamAck,
    check_version,
    decode,
    encode,
    frame,
)
from hapticnet.device.servos import Linkage, Pulses, Servo, Servos
from hapticnet.errors import PeerError, RefusedError
from hapticnet.hardware import MAX_FORCE_N, SERVO_FRAME_US

REPEAT_US: Final = SERVO_FRAME_US  # longest time between setpoints [µs]; the firmware retracts after 190 ms without one
LEAD_US: Final = 1_000
SLOT_US: Final = 2_500
"""Time [µs] from the firmware's choice of a setpoint to the first pulse of the frame, and between the starts of its
three pulses (firmware/avr/clock.c). A servo takes a pulse when it ends."""

DELAY_US: Final = 1_000 + LEAD_US + SLOT_US + 1_500
"""Time [µs] from a setpoint to the end of the second of the three pulses, of 1.5 ms, in a frame that begins as soon as
the setpoint arrives; the first millisecond is spent on the line."""

JITTER_US: Final = 0.5
"""Largest error [µs] of a pulse width (0.44 in simavr). A step must exceed the servo's deadband by this margin, or the
servo takes it frames later."""

REMEMBERED: Final = 256  # setpoints kept until the device reports that it took them; at most one is sent per ms


class Setpoints:
    """Convert displacements to setpoints, and estimate the position of the platform from those that were taken.

    The device chose a setpoint up to one reading period before the first reading that reports it, so the estimate is
    late by half a period on average.
    """

    def __init__(self, linkage: Linkage, servo: Servo) -> None:
        self._linkage = replace(linkage, deadband_us=linkage.deadband_us + JITTER_US)
        self._estimate = Servos(linkage, replace(servo, backlash_deg=0.0))
        retracted_us = linkage.retracted_us
        self._retracted_us: Pulses = (retracted_us, retracted_us, retracted_us)
        self.held_us = self._sent_us = self._planned_us = self._retracted_us  # held: in the last reported frame
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


ASK_AGAIN_US: Final = 100_000  # time [µs] to wait for an answer to HELLO or STREAM before asking again
PATIENCE_US: Final = 3_000_000
"""Time [µs] to wait for an answer to HELLO: the bootloader of a Nano discards input for 1 to 2 s, typically."""

SILENCE_US: Final = 50_000  # time [µs] without a reading after which a streaming device counts as lost
LONGEST_STEP_US: Final = 10_000  # largest contribution [µs] of one step to the silence: a stalled host receives nothing
STREAM_PERIOD_MS: Final = 2  # requested period of readings [ms]: five per control period
READY: Final = "ready"  # `WiredDevice.status` while there are readings


class _State(Enum):
    ABSENT = "absent"
    GREETING = "greeting"
    STARTING = "starting"
    STREAMING = "streaming"
    REFUSED = "refused"


def reset_cause(identity: Identity) -> str:
    """Return a description of the device's last reset."""
    causes = [words for bit, words in RESET_CAUSES.items() if identity.reset_cause & bit]
    return " and ".join(causes) or "unknown"


def firmware_version(identity: Identity) -> str:
    """Return the version of the device's firmware as text."""
    return f"{identity.firmware_major}.{identity.firmware_minor}.{identity.firmware_patch}"


class WiredDevice(Device):
    """A fingertip device on a serial line.

    The owner moves the bytes: `opened` and `closed` report the state of the port, `receive` takes the bytes read, and
    after each `exchange` and `receive`, `bytes_to_send` returns what to write. No input can make it raise.
    The last force of the calibration limits the target; the model of the servos estimates their position.
    """

    def __init__(self, calibration: Calibration, *, linkage: Linkage | None = None, servo: Servo | None = None) -> None:
        self._calibration = calibration
        linkage = linkage or Linkage()
        self._setpoints = Setpoints(linkage, servo or Servo())
        self.delay_us = DELAY_US
        # Beyond its table the reading does not rise, and the force loop would keep pressing.
        self.capabilities = presses(linkage.travel_m, min(MAX_FORCE_N, calibration.forces_n[-1]))
        self.description = "device on a serial line"
        self.status = "the port is not open"
        self.identity: Identity | None = None  # answer to HELLO since the port was opened
        self.refusal: str | None = None  # why the device is not used until the port is reopened, and the remedy
        self.wants_reopening = False  # whether to reopen the port, which resets a Nano, because it is silent
        self.stream_period_ms = 0  # period of readings granted by the device [ms]; 0 before
        self._state = _State.ABSENT
        self._deframer = Deframer()
        self._request = b""  # HELLO or STREAM; a newer one replaces it, as for setpoints
        self._setpoint = b""
        self._reading: Reading | None = None
        self._now_us = 0
        self._waited_us = 0  # time waited for a reading or an answer, depending on the state
        self._asked_us = 0  # the same clock
        self._heard_bytes = 0  # while greeting
        self._unanswered = False
        self._last: SensorReading | None = None  # of this boot
        self._boot_id: int | None = None
        self._bytes = self._sent = self._readings = self._unknown = self._malformed = 0
        self._lost = self._resets = self._gaps = self._damaged = self._refused = self._overruns = 0

    def opened(self, now_us: int) -> None:
        """Note that the port was opened, and start over."""
        self.identity = None
        self.refusal = None
        self._boot_id = None
        self._last = None
        self._now_us = now_us
        self._deframer.feed(b"\0")
        if not self._unanswered:  # otherwise keep the reason found last time
            self.status = "waiting for an answer to HELLO"
        self._greet()

    def closed(self, reason: str, now_us: int, *, orderly: bool = False) -> None:
        """Note that the port was closed and why; `orderly`: the owner closed it without a fault."""
        self._now_us = now_us
        self._stop(_State.ABSENT, lost=not orderly)
        if not self.wants_reopening:  # otherwise it was closed only to be reopened
            self._unanswered = False
            if not orderly:
                self.status = reason
        self.wants_reopening = False

    def receive(self, data: bytes, now_us: int) -> None:
        """Process arbitrary bytes from the line."""
        self._bytes += len(data)
        self._heard_bytes += len(data)
        for body in self._deframer.feed(data):
            try:
                message = decode(body)
            except PeerError:
                if body[0] in LAYOUTS:
                    self._malformed += 1
                else:
                    self._unknown += 1
                continue
            if self._state in (_State.ABSENT, _State.REFUSED):
                continue
            if isinstance(message, SensorReading):
                self._take_reading(message, now_us)
            elif isinstance(message, Identity):
                self._take_identity(message, now_us)
            elif isinstance(message, StreamAck):
                self.stream_period_ms = message.period_ms
            else:  # a message that only hosts send
                self._unknown += 1

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Set the platform displacement [m] and return the newest reading, or None while the device is lost."""
        self._waited_us += min(max(now_us - self._now_us, 0), LONGEST_STEP_US)
        self._now_us = now_us
        if self._state is _State.STREAMING:
            if self._waited_us < SILENCE_US:
                setpoint = self._setpoints.next(displacement_m, now_us)
                if setpoint:
                    self._setpoint = frame(encode(setpoint))
                return self._reading
            self.status = f"lost: silent for {SILENCE_US // 1000} ms"
            self._greet()
        elif self._state is _State.GREETING or self._state is _State.STARTING:
            self._wait()
        return None

    def bytes_to_send(self) -> bytes:
        """Return the bytes to write to the line now."""
        data = self._request + self._setpoint
        if self._setpoint:
            self._sent += 1
        self._request = self._setpoint = b""
        return data

    def report(self) -> dict[str, object]:
        """Return counters of the line, over all openings of the port."""
        who = self.identity
        return {
            "status": self.status,
            "firmware": firmware_version(who) if who else None,
            "reset_cause": reset_cause(who) if who else None,
            "stream_period_ms": self.stream_period_ms,
            "bytes_received": self._bytes,
            "frames_received": self._deframer.received,
            "frames_damaged": self._deframer.damaged,
            "messages_unknown": self._unknown,
            "messages_malformed": self._malformed,
            "readings": self._readings,
            "readings_lost": self._gaps,
            "setpoints_sent": self._sent,
            "times_lost": self._lost,
            "resets_seen": self._resets,
            "device_frames_damaged": self._damaged,
            "device_messages_refused": self._refused,
            "device_overruns": self._overruns,
        }

    def _stop(self, state: _State, *, lost: bool = True) -> None:
        if self._state is _State.STREAMING:
            self._lost += lost
            self._setpoints.retract(self._now_us)
        self._state = state
        self._request = self._setpoint = b""
        self._reading = None
        self._waited_us = self._asked_us = 0

    def _greet(self) -> None:
        self._stop(_State.GREETING)
        self._heard_bytes = 0
        self.wants_reopening = False
        self._ask(Hello())

    def _ask(self, message: Hello | Stream) -> None:
        # The delimiter in front ends a partial frame that the device may have received before.
        self._request = b"\0" + frame(encode(message))
        self._asked_us = self._waited_us

    def _wait(self) -> None:
        if self._waited_us - self._asked_us >= ASK_AGAIN_US:
            self._ask(Hello() if self._state is _State.GREETING else Stream(STREAM_PERIOD_MS))
        if self._waited_us >= PATIENCE_US and not self.wants_reopening:
            self.wants_reopening = True
            self._unanswered = True
            self.status = self._complaint()

    def _complaint(self) -> str:
        seconds = f"{PATIENCE_US // 1_000_000} s"
        if self._state is _State.STARTING:
            return f"answers HELLO, but has sent no readings for {seconds}"
        if self.identity:
            return f"has not answered HELLO for {seconds}, though it did before"
        if self._heard_bytes:
            return (
                f"no answer to HELLO in {seconds}, only {self._heard_bytes} other bytes: another device or baud rate?"
            )
        return f"no answer to HELLO in {seconds}: another device or baud rate, or no firmware?"

    def _take_identity(self, identity: Identity, now_us: int) -> None:
        """Start the stream: on any HELLO, even an old one, the device stopped it and retracted."""
        self._stop(_State.STARTING)
        self._unanswered = False
        self.wants_reopening = False
        self.identity = identity
        self.description = f"device on a serial line, firmware {firmware_version(identity)}"
        if self._boot_id is not None and identity.boot_id != self._boot_id:
            self._note_reset()
        self._boot_id = identity.boot_id
        try:
            check_version(identity)
        except RefusedError as error:
            self._state = _State.REFUSED
            self.refusal = self.status = str(error)
            return
        self.status = f"starting after reset ({reset_cause(identity)})"
        self._setpoints.start(identity, now_us)
        self._ask(Stream(STREAM_PERIOD_MS))

    def _note_reset(self) -> None:
        self._resets += 1
        self._boot_id = None
        self._last = None  # its counters restarted

    def _take_reading(self, new: SensorReading, now_us: int) -> None:
        if self._state is _State.GREETING:  # from a stream that our HELLO will stop
            return
        last = self._last
        if new.boot_id != self._boot_id or (last and (new.uptime_ms - last.uptime_ms) & 0xFFFFFFFF >= 1 << 31):
            self._note_reset()
            self.status = "the device was reset; greeting it again"
            self._greet()
            return
        self._last = new
        self._readings += 1
        self._waited_us = 0
        if last:
            gap = (new.sequence - last.sequence - 1) & 0xFFFF
            self._gaps += gap if gap < 1 << 15 else 0  # a repeated reading is not a gap
            self._damaged += (new.damaged - last.damaged) & 0xFF
            self._refused += (new.refused - last.refused) & 0xFF
            self._overruns += (new.overruns - last.overruns) & 0xFF
        if self._state is _State.STARTING:
            self._state = _State.STREAMING
            self.status = READY
        self._setpoints.follow(new, now_us)
        counts = new.adc / ADC_FRACTION
        self._reading = Reading(now_us, counts, self._calibration.force_n(counts), self._setpoints.displacement_m)
