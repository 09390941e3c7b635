"""A Python stand-in for the firmware on the serial line, for tests without the compiled one."""

from typing import TYPE_CHECKING

from hapticnet.device.base import Reading
from hapticnet.device.calibration import Calibration
from hapticnet.device.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    Deframer,
    Flag,
    Hello,
    Identity,
    SensorReading,
    Setpoint,
    Stream,
    StreamAck,
    decode,
    encode,
    frame,
)
from hapticnet.device.servos import Linkage, Servo, Servos
from hapticnet.device.wired import LEAD_US, SLOT_US, WiredDevice

if TYPE_CHECKING:
    from collections.abc import Callable

CALIBRATION = Calibration(counts=(100.0, 900.0), forces_n=(0.2, 5.0))
SHORTEST, LONGEST, RETRACTED, STEP = 2360, 4040, 2400, 120
FRAME_MS, SILENCE_MS = 20, 190


class StandIn:
    """A device that ticks in milliseconds."""

    def __init__(self, *, boot_id: int = 7, reset_cause: int = 2, major: int = PROTOCOL_MAJOR) -> None:
        self.sent = b""  # bytes sent and not yet read
        # Every received setpoint with the pulses held at that time
        self.setpoints: list[tuple[Setpoint, tuple[int, ...]]] = []
        self.servos = Servos(Linkage(), Servo(backlash_deg=0.0))
        self.adc = 0
        self.major = major
        self.fastest_ms = 1
        self.step_limited = 0
        self._boot(boot_id, reset_cause)

    def _boot(self, boot_id: int, cause: int) -> None:
        self.boot_id, self.cause = boot_id, cause
        self.deframer = Deframer()
        self.ms = self.sequence = self.applied = self.heard_ms = self.refused = self.period_ms = 0
        self.greeted = self.commanded = self.limited = False
        self.pulses: list[tuple[int, int, float]] = []  # chosen, not yet ended
        self.wanted: Setpoint | None = None
        self.held: tuple[int, ...] = (RETRACTED,) * 3

    def reset(self, cause: int = 8) -> None:
        """Restart, as after a watchdog reset."""
        self.sent = b""
        self._boot(self.boot_id + 1, cause)

    def receive(self, data: bytes) -> None:
        for body in self.deframer.feed(data):
            message = decode(body)
            if isinstance(message, Hello):
                self.greeted = message.protocol_major == self.major
                self.commanded = False
                self.period_ms = 0
                limits = (SHORTEST, LONGEST) * 3
                identity = Identity(
                    self.major, PROTOCOL_MINOR, 0, 1, 0, self.cause, self.boot_id, 16_000_000, *limits, STEP, 10
                )
                self.sent += frame(encode(identity))
            elif isinstance(message, Stream) and self.greeted:
                self.period_ms = max(message.period_ms, self.fastest_ms)
                self.sent += frame(encode(StreamAck(message.period_ms, self.period_ms)))
            elif (
                isinstance(message, Setpoint)
                and self.greeted
                and all(SHORTEST <= pulse <= LONGEST for pulse in message[1:])
            ):
                self.setpoints.append((message, self.held))
                self.wanted, self.heard_ms, self.commanded = message, self.ms, True
            else:
                self.refused += 1

    def tick(self) -> None:
        """Advance by a millisecond."""
        self.ms += 1
        since_us = 1000
        while self.pulses and self.pulses[0][0] <= self.ms * 1000:
            end_us, servo, pulse_us = self.pulses.pop(0)
            left_us = max(self.ms * 1000 - end_us, 0)
            self.servos.move(since_us - left_us)
            self.servos.take_one(servo, pulse_us)
            since_us = left_us
        self.servos.move(since_us)
        if self.ms % FRAME_MS == 0:
            self._frame()
        if self.period_ms and self.ms % self.period_ms == 0:
            flags = Flag.GREETED * self.greeted | Flag.RETRACTED * (not self.commanded)
            flags |= Flag.STEP_LIMITED * self.limited
            counters = (self.deframer.damaged & 0xFF, self.refused & 0xFF, 0)
            reading = SensorReading(self.sequence, self.ms, self.boot_id, self.adc, flags, self.applied, *counters)
            self.sequence = (self.sequence + 1) & 0xFFFF
            self.sent += frame(encode(reading))

    def take_sent(self) -> bytes:
        sent, self.sent = self.sent, b""
        return sent

    def _frame(self) -> None:
        self.commanded &= self.ms - self.heard_ms < SILENCE_MS
        if self.commanded and self.wanted:
            self.applied = self.wanted.sequence
            before = self.held
            self.held = tuple(min(pulse, held + STEP) for pulse, held in zip(self.wanted[1:], before, strict=True))
            self.limited = self.held != self.wanted[1:]
        else:
            self.held, self.limited = (RETRACTED,) * 3, False
        self.step_limited += self.limited
        for servo, pulse in enumerate(self.held):
            end_us = self.ms * 1000 + LEAD_US + servo * SLOT_US + pulse // 2
            self.pulses.append((end_us, servo, pulse / 2))


class Line:
    """A wired device and the stand-in at the other end, in virtual time."""

    def __init__(self, host: WiredDevice, device: StandIn) -> None:
        self.host, self.device = host, device
        self.now_us = 5_000_000
        # Functions applied to the bytes in each direction; replace them for noise and loss
        self.host_hears: Callable[[bytes], bytes] = bytes
        self.device_hears: Callable[[bytes], bytes] = bytes

    def open(self) -> None:
        self.host.opened(self.now_us)

    def step(self, displacement_m: float = 0.0, *, host_stalled: bool = False) -> Reading | None:
        """Advance by a millisecond; return the result of the host's exchange."""
        self.now_us += 1000
        self.device.tick()
        if host_stalled:
            return None
        heard = self.host_hears(self.device.take_sent())
        if heard:
            self.host.receive(heard, self.now_us)
        reading = self.host.exchange(displacement_m, self.now_us)
        self.device.receive(self.device_hears(self.host.bytes_to_send()))
        return reading

    def run(self, ms: int, displacement_m: float = 0.0) -> Reading | None:
        """Advance by some milliseconds; return the result of the last exchange."""
        reading = None
        for _ in range(ms):
            reading = self.step(displacement_m)
        return reading


def line(device: StandIn | None = None) -> Line:
    made = Line(WiredDevice(CALIBRATION), device or StandIn())
    made.open()
    return made


def streaming(device: StandIn | None = None) -> Line:
    made = line(device)
    made.run(10)
    assert made.host.status == "ready"
    return made
