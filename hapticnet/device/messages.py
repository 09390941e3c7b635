"""Messages between host and firmware: their layouts, and their frames on the serial line."""

import binascii
import struct
from typing import Final, NamedTuple, TypeAlias

from hapticnet.errors import PeerError, RefusedError, SettingsError

PROTOCOL_MAJOR: Final = 1  # a device with another major version is refused, because layouts or meanings differ
PROTOCOL_MINOR: Final = 0  # incremented for additions that an older peer may ignore
TICKS_PER_US: Final = 2  # Timer ticks per µs of a pulse: Timer1 of the ATmega328P at 16 MHz / 8 has ticks of 0.5 µs
ADC_FRACTION: Final = 64  # an averaged reading is in 1/64 count, the finest unit in which 1023 counts fit in 16 bits
FLASH_COMMAND: Final = "make -C firmware flash PORT=/dev/ttyUSB0"
RESET_CAUSES: Final = {1: "power-on", 2: "reset button or port opened", 4: "brown-out", 8: "watchdog"}
"""Bits of MCUSR, ATmega328P data sheet."""


class Flag:
    """Bits of `SensorReading.flags`."""

    GREETED: Final = 1  # a HELLO of this protocol was received since the reset; setpoints are accepted
    RETRACTED: Final = 2  # no setpoint is in force: none was received yet, or the host is silent; servos are retracted
    STEP_LIMITED: Final = 4  # at the last servo frame, the step limit kept a servo from reaching its setpoint


class Hello(NamedTuple):
    """Host: request the identity. The device retracts, stops the stream and accepts setpoints from then on."""

    protocol_major: int = PROTOCOL_MAJOR
    protocol_minor: int = PROTOCOL_MINOR


class Setpoint(NamedTuple):
    """Host: three servo pulses [ticks of 0.5 µs]; the newest setpoint is applied at the next 50 Hz frame.

    `sequence` is any 16-bit number, returned as `SensorReading.applied_sequence`. The whole setpoint is refused if a
    pulse is outside the limits of its servo.
    """

    sequence: int
    pulse_0: int
    pulse_1: int
    pulse_2: int


class Stream(NamedTuple):
    """Host: request a reading every `period_ms` [ms], 1 to 255, or none (0). Answered by `StreamAck`."""

    period_ms: int


class Identity(NamedTuple):
    """Device: answer to HELLO of any version.

    `reset_cause` is MCUSR after the last reset; `boot_id` is incremented at every reset; `clock_hz` [Hz]; then the
    pulse limits of each servo and the largest step toward a setpoint per servo frame [ticks of 0.5 µs].
    """

    protocol_major: int
    protocol_minor: int
    firmware_major: int
    firmware_minor: int
    firmware_patch: int
    reset_cause: int
    boot_id: int
    clock_hz: int
    shortest_0: int
    longest_0: int
    shortest_1: int
    longest_1: int
    shortest_2: int
    longest_2: int
    largest_step: int
    adc_bits: int

    @property
    def pulse_limits(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
        """Shortest and longest pulse of each servo [ticks of 0.5 µs]."""
        return ((self.shortest_0, self.longest_0), (self.shortest_1, self.longest_1), (self.shortest_2, self.longest_2))


class SensorReading(NamedTuple):
    """Device: the sensor's mean over the last millisecond, and the state of the device.

    `sequence` is incremented for each reading, sent or dropped; `uptime_ms` [ms] since reset; `adc` [1/64 count];
    `applied_sequence` of the setpoint taken at the last servo frame; then counters modulo 256: damaged frames from the
    host, refused messages, bytes lost because they were not read in time.
    """

    sequence: int
    uptime_ms: int
    boot_id: int
    adc: int
    flags: int
    applied_sequence: int
    damaged: int
    refused: int
    overruns: int


class StreamAck(NamedTuple):
    """Device: the requested period and the granted one [ms]; a slow line cannot carry 1 kHz."""

    asked_ms: int
    period_ms: int


Message: TypeAlias = Hello | Setpoint | Stream | Identity | SensorReading | StreamAck

LAYOUTS: Final[dict[int, tuple[type[Message], struct.Struct]]] = {  # message class and layout of each kind
    0x01: (Hello, struct.Struct("<BB")),
    0x02: (Setpoint, struct.Struct("<H3H")),
    0x03: (Stream, struct.Struct("<B")),
    0x81: (Identity, struct.Struct("<BBBBBBHI6HHB")),
    0x82: (SensorReading, struct.Struct("<HIHHBHBBB")),
    0x83: (StreamAck, struct.Struct("<BB")),
}

_BY_CLASS: Final = {message: (bytes((kind,)), layout) for kind, (message, layout) in LAYOUTS.items()}


def encode(message: Message) -> bytes:
    """Return the body of a message. Raises SettingsError if a field is not an integer or is out of range."""
    kind, layout = _BY_CLASS[type(message)]
    try:
        return kind + layout.pack(*message)
    except struct.error as error:
        raise SettingsError(f"{message} does not fit its layout {layout.format!r}: {error}") from error


def decode(body: bytes) -> Message:
    """Return the message in a body. Raises PeerError if the kind is unknown or the length does not match it."""
    entry = LAYOUTS.get(body[0]) if body else None
    if entry is None:
        kind = body[:1].hex() or "missing"
        raise PeerError(f"kind {kind} ({len(body)} bytes) is not in protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}")
    message, layout = entry
    if len(body) != layout.size + 1:
        raise PeerError(f"{message.__name__} has {len(body)} bytes; it must have {layout.size + 1}")
    return message(*layout.unpack_from(body, 1))


def check_version(identity: Identity) -> None:
    """Check that a device speaks this protocol.

    Raise RefusedError if the major versions differ; the message says how to flash the matching firmware.
    """
    if identity.protocol_major != PROTOCOL_MAJOR:
        raise RefusedError(
            f"the device speaks protocol {identity.protocol_major}.{identity.protocol_minor}, this host "
            f"{PROTOCOL_MAJOR}.{PROTOCOL_MINOR}; flash the firmware of this release: {FLASH_COMMAND}"
        )


LONGEST_BODY: Final = 48  # longest message [bytes], including its kind; the size of the firmware's buffers
LONGEST_FRAME: Final = LONGEST_BODY + 3  # without its delimiter: adds 2 bytes of CRC and 1 byte of COBS

_CRC_START: Final = 0xFFFF


def _crc(body: bytes) -> bytes:
    """CRC-16/CCITT-FALSE, little-endian; its check value for "123456789" is 0x29B1."""
    return binascii.crc_hqx(body, _CRC_START).to_bytes(2, "little")


def frame(body: bytes) -> bytes:
    """Return a message as a frame with its delimiter."""
    blocks = (body + _crc(body)).split(b"\0")
    return b"".join(bytes((len(block) + 1,)) + block for block in blocks) + b"\0"


def _unstuffed(stuffed: bytes) -> bytes | None:
    """Decode COBS; None if a length byte points past the end. Frames are too short for blocks of 254 bytes."""
    blocks = []
    at = 0
    while at < len(stuffed):
        beyond = at + stuffed[at]
        if beyond > len(stuffed):
            return None
        blocks.append(stuffed[at + 1 : beyond])
        at = beyond
    return b"\0".join(blocks)


class Deframer:
    """Extract messages from a stream of bytes that may start anywhere and contain anything."""

    __slots__ = ("_oversize", "_partial", "damaged", "received")

    def __init__(self) -> None:
        self.received = 0  # number of messages with a correct CRC
        self.damaged = 0  # frames whose COBS, CRC or length was wrong, or that were incomplete at the start
        self._partial = b""
        self._oversize = False

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes; return the messages they complete, oldest first."""
        *ended, rest = data.split(b"\0")
        bodies = []
        for end in ended:
            body = None if self._oversize else self._body(self._partial + end)
            if body is not None:
                bodies.append(body)
            elif self._oversize or self._partial or end:
                self.damaged += 1
            self._partial = b""
            self._oversize = False
        if len(self._partial) + len(rest) > LONGEST_FRAME:
            self._oversize = True
        # An oversize frame is discarded, so memory stays bounded on a line without delimiters.
        self._partial = b"" if self._oversize else self._partial + rest
        self.received += len(bodies)
        return bodies

    def _body(self, stuffed: bytes) -> bytes | None:
        if len(stuffed) > LONGEST_FRAME:
            return None
        checked = _unstuffed(stuffed)
        if checked is None or len(checked) < 3 or _crc(checked[:-2]) != checked[-2:]:
            return None
        return checked[:-2]
