"""What host and firmware say to each other: one table of layouts.

Everything is little-endian and of fixed length. The first byte of a message is its kind; kinds the host sends are below
128. ``tests/vectors/device.json`` holds every message as bytes, and both this module and the firmware are tested on it.
"""

import struct
from typing import Final, NamedTuple, TypeAlias

from hapticnet.errors import PeerError, RefusedError, SettingsError

PROTOCOL_MAJOR: Final = 1
"""A device with another major version is refused: layouts or their meaning differ."""

PROTOCOL_MINOR: Final = 0
"""Grows with additions an older peer may ignore."""

TICKS_PER_US: Final = 2
"""Pulses are in ticks of 0.5 µs: Timer1 of the ATmega328P at 16 MHz / 8."""

ADC_FRACTION: Final = 64
"""An averaged reading is in 1/64 count, the finest in which 1023 counts fit 16 bits."""

FLASH_COMMAND: Final = "make -C firmware flash PORT=/dev/ttyUSB0"

RESET_CAUSES: Final = {1: "power-on", 2: "reset button or port opened", 4: "brown-out", 8: "watchdog"}
"""Bits of MCUSR, ATmega328P data sheet."""


class Flag:
    """Bits of `SensorReading.flags`."""

    GREETED: Final = 1
    """A HELLO of this protocol was heard since the reset; setpoints are taken."""
    RETRACTED: Final = 2
    """No setpoint is in force: none came yet, or the host fell silent. The servos are retracted."""
    STEP_LIMITED: Final = 4
    """At the last servo frame a servo was not allowed to go all the way to its setpoint."""


class Hello(NamedTuple):
    """Host: who are you? Starts afresh: retracts, stops the stream; setpoints are taken from now on."""

    protocol_major: int = PROTOCOL_MAJOR
    protocol_minor: int = PROTOCOL_MINOR


class Setpoint(NamedTuple):
    """Host: three servo pulses [ticks of 0.5 µs]; the newest is applied at the next 50 Hz frame.

    `sequence` is any 16-bit number; it comes back as `SensorReading.applied_sequence`. Refused as a whole when a pulse
    is outside the limits of its servo.
    """

    sequence: int
    pulse_0: int
    pulse_1: int
    pulse_2: int


class Stream(NamedTuple):
    """Host: send a reading every `period_ms` [ms], 1 to 255; 0 sends none. Answered by `StreamAck`."""

    period_ms: int


class Identity(NamedTuple):
    """Device: answer to HELLO, whatever its version.

    `reset_cause` is MCUSR as the last reset left it; `boot_id` grows by one at every reset; `clock_hz` [Hz]; pulse
    limits of each servo and the largest step toward a setpoint per servo frame [ticks of 0.5 µs].
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
        return (
            (self.shortest_0, self.longest_0),
            (self.shortest_1, self.longest_1),
            (self.shortest_2, self.longest_2),
        )


class SensorReading(NamedTuple):
    """Device: what the sensor read over the last millisecond, and how the device fares.

    `sequence` grows by one per reading, sent or dropped; `uptime_ms` [ms] since reset; `adc` [1/64 count];
    `applied_sequence` of the setpoint taken at the last servo frame; then counters that wrap at 256: frames from the
    host that were damaged, messages refused, bytes lost because nobody fetched them.
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
    """Device: the period asked for, and the one in force [ms]: a slow line cannot carry 1 kHz."""

    asked_ms: int
    period_ms: int


Message: TypeAlias = Hello | Setpoint | Stream | Identity | SensorReading | StreamAck

LAYOUTS: Final[dict[int, tuple[type[Message], struct.Struct]]] = {
    0x01: (Hello, struct.Struct("<BB")),
    0x02: (Setpoint, struct.Struct("<H3H")),
    0x03: (Stream, struct.Struct("<B")),
    0x81: (Identity, struct.Struct("<BBBBBBHI6HHB")),
    0x82: (SensorReading, struct.Struct("<HIHHBHBBB")),
    0x83: (StreamAck, struct.Struct("<BB")),
}
"""Kind: what it says, and how."""

_BY_CLASS: Final = {message: (bytes((kind,)), layout) for kind, (message, layout) in LAYOUTS.items()}


def encode(message: Message) -> bytes:
    """Return the body of a message.

    Raises
    ------
    SettingsError
        If a field is no integer or does not fit its place.
    """
    kind, layout = _BY_CLASS[type(message)]
    try:
        return kind + layout.pack(*message)
    except struct.error as error:
        raise SettingsError(f"{message} does not fit its layout {layout.format!r}: {error}") from error


def decode(body: bytes) -> Message:
    """Return the message in a body.

    Raises
    ------
    PeerError
        If the kind is unknown, or the length is not that of the kind.
    """
    entry = LAYOUTS.get(body[0]) if body else None
    if entry is None:
        kind = body[:1].hex() or "missing"
        raise PeerError(f"kind {kind} ({len(body)} bytes) is none of protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}")
    message, layout = entry
    if len(body) != layout.size + 1:
        raise PeerError(f"{message.__name__} has {len(body)} bytes; it must have {layout.size + 1}")
    return message(*layout.unpack_from(body, 1))


def check_version(identity: Identity) -> None:
    """Refuse a device whose protocol is another.

    Raises
    ------
    RefusedError
        If the major versions differ; the message says how to flash the firmware of this release.
    """
    if identity.protocol_major != PROTOCOL_MAJOR:
        raise RefusedError(
            f"the device speaks protocol {identity.protocol_major}.{identity.protocol_minor}, this host "
            f"{PROTOCOL_MAJOR}.{PROTOCOL_MINOR}; give it the firmware of this release: {FLASH_COMMAND}"
        )
