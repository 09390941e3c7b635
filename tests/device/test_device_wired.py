"""The host's end of the serial line with a stand-in for the firmware, in virtual time."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.base import Device
from hapticnet.device.calibration import Calibration
from hapticnet.device.messages import (
    FLASH_COMMAND,
    LAYOUTS,
    LONGEST_BODY,
    Identity,
    SensorReading,
    Setpoint,
    StreamAck,
    encode,
    frame,
)
from hapticnet.device.wired import WiredDevice
from tests.device.standin import CALIBRATION, StandIn, line, streaming

ANY = st.floats(allow_nan=True, allow_infinity=True)


def test_is_a_device_that_is_lost_until_its_port_is_opened() -> None:
    assert Device in WiredDevice.__mro__
    host = WiredDevice(Calibration(counts=(100.0, 900.0), forces_n=(0.2, 4.0)))
    assert host.exchange(0.001, 1_000) is None
    assert host.bytes_to_send() == b""
    assert host.status == "the port is not open"
    assert host.capabilities.max_force_n == 4.0  # the end of its table
    assert WiredDevice(Calibration(counts=(100.0, 900.0), forces_n=(0.2, 20.0))).capabilities.max_force_n == 5.0
    assert 0.015 <= host.capabilities.travel_m < 0.016


def test_sends_hello_requests_a_stream_and_gives_readings() -> None:
    made = line()
    assert made.host.status == "waiting for an answer to HELLO"
    made.device.adc = 500 * 64 + 32
    reading = made.run(10)
    assert reading is not None
    assert reading.t_us == made.now_us
    assert reading.adc == 500.5
    assert reading.force_n == CALIBRATION.force_n(500.5)
    assert reading.displacement_m == 0.0
    assert made.host.status == "ready"
    assert "firmware 0.1.0" in made.host.description
    assert made.host.identity is not None
    assert made.host.identity.boot_id == 7
    assert made.host.report()["reset_cause"] == "reset button or port opened"
    assert made.host.report()["stream_period_ms"] == 2


def test_a_reading_stays_until_the_next() -> None:
    made = line()
    made.device.fastest_ms = 5
    made.run(19)
    times = [reading.t_us for _ in range(100) if (reading := made.step())]
    assert len(times) == 100
    assert len(set(times)) == 20
    assert made.host.report()["stream_period_ms"] == 5


def test_starts_although_a_bootloader_discards_the_first_bytes() -> None:
    made = line()
    made.device_hears = lambda _: b""
    assert made.run(1500) is None
    assert made.host.wants_reopening is False
    made.device_hears = bytes
    assert made.run(110) is not None
    assert made.host.report()["times_lost"] == 0


def test_a_stream_that_does_not_start_is_requested_again() -> None:
    made = line()
    made.run(1)  # HELLO was sent
    made.device_hears = lambda data: b""  # noqa: ARG005
    assert made.run(50) is None
    made.device_hears = bytes
    assert made.run(110) is not None


def test_a_device_that_answers_hello_but_never_streams_is_reopened() -> None:
    made = line()
    made.host_hears = lambda data: b"" if made.host.identity else data
    made.run(3_100)
    assert made.host.wants_reopening
    assert "answers HELLO" in made.host.status


@pytest.mark.parametrize(
    ("chatter", "words"),
    [(b"", "no answer to HELLO"), (b"$GPGGA,123519,4807.038,N\r\n", "another device or baud rate")],
    ids=["silent", "text"],
)
def test_a_wrong_device_is_reported_after_three_seconds(chatter: bytes, words: str) -> None:
    made = line()
    made.host_hears = lambda _: chatter
    made.run(2_990)
    assert not made.host.wants_reopening
    made.run(20)
    assert made.host.wants_reopening
    assert words in made.host.status
    assert made.run(1) is None
    made.host.closed("closed", made.now_us)
    made.open()
    assert words in made.host.status  # the message must stay visible
    assert not made.host.wants_reopening
    made.host_hears = bytes
    made.run(10)
    assert made.host.status == "ready"


def test_garbage_affects_only_the_frames_it_hits() -> None:
    made = line()
    rng = random.Random(1)
    made.host.receive(rng.randbytes(500), made.now_us)
    made.device.receive(b"\x07half")
    made.run(120)  # the first answer may end a frame that the garbage began
    assert made.host.status == "ready"
    assert made.device.deframer.damaged == 1
    before = int(str(made.host.report()["readings"]))

    def noise(data: bytes) -> bytes:
        return data if rng.random() < 0.9 else data[:7] + rng.randbytes(rng.randrange(40))

    made.host_hears = noise
    for _ in range(2000):
        assert made.step(0.002) is not None
    after = int(str(made.host.report()["readings"]))
    assert 700 < after - before < 980
    made.host_hears = bytes
    made.run(6, 0.002)  # a truncated frame also damages the next one
    received = int(str(made.host.report()["readings"]))
    assert received + int(str(made.host.report()["readings_lost"])) == made.device.sequence
    assert int(str(made.host.report()["frames_damaged"])) > 100


def test_silence_is_detected_within_sixty_ms_and_the_device_comes_back_retracted() -> None:
    made = streaming()
    made.run(300, 0.005)
    made.host_hears = lambda _: b""
    assert made.run(48, 0.005) is not None
    assert made.run(12, 0.005) is None
    assert "silent" in made.host.status
    made.run(500, 0.005)
    made.host_hears = bytes
    readings = [reading for _ in range(150) if (reading := made.step())]
    assert len(readings) > 40
    assert all(reading.displacement_m < 1e-4 for reading in readings)
    assert made.device.servos.displacement_m < 1e-4
    assert made.host.report()["times_lost"] == 1
    assert made.host.report()["resets_seen"] == 0


def test_a_stall_of_the_host_is_not_a_loss_of_the_device() -> None:
    made = streaming()
    for stall_ms in (40, 100, 1000):
        for _ in range(stall_ms):
            made.step(host_stalled=True)
        # The tick comes first, then the bytes received meanwhile.
        made.now_us += 1
        assert made.host.exchange(0.0, made.now_us) is not None
        assert made.step() is not None
    assert made.host.report()["times_lost"] == 0


def test_clock_jumps_do_no_harm() -> None:
    made = streaming()
    now_us = made.now_us
    for jump_us in (-10_000_000, 10**12, 0, 0):
        assert made.host.exchange(0.001, now_us + jump_us) is not None
    made.now_us = 1000
    assert made.run(100, 0.001) is not None


@pytest.mark.parametrize("silent_ms", [0, 30, 400])
def test_a_reset_is_detected_and_its_cause_reported(silent_ms: int) -> None:
    made = streaming()
    made.run(500, 0.005)
    made.device.reset(cause=8)
    made.host_hears = lambda _: b""
    made.run(silent_ms, 0.005)
    made.host_hears = bytes
    seen = set()
    for _ in range(300):
        made.step(0.005)
        seen.add(made.host.status)
    assert "starting after reset (watchdog)" in seen
    assert made.host.status == "ready"
    assert made.host.report()["resets_seen"] == 1
    assert made.host.report()["times_lost"] == 1
    assert made.host.report()["reset_cause"] == "watchdog"


@pytest.mark.parametrize("what", ["boot_id", "uptime_ms"])
def test_a_reading_after_another_boot_is_a_reset(what: str) -> None:
    made = streaming()
    made.run(100, 0.005)
    last = SensorReading(made.device.sequence, 3, made.device.boot_id, 0, 1, 0, 0, 0, 0)
    if what == "boot_id":
        last = last._replace(uptime_ms=made.device.ms + 1, boot_id=8)
    made.host.receive(frame(encode(last)), made.now_us)
    assert made.host.exchange(0.005, made.now_us) is None
    assert "reset" in made.host.status
    assert made.host.report()["resets_seen"] == 1
    assert made.run(110) is not None


def test_the_uptime_may_wrap() -> None:
    made = streaming()
    reading = SensorReading(made.device.sequence, made.device.ms, made.device.boot_id, 0, 3, 0, 0, 0, 0)
    for uptime_ms in (2**30, 2**31 + 2**29, 2**32 - 1, 0, 1):
        made.host.receive(frame(encode(reading._replace(uptime_ms=uptime_ms))), made.now_us)
    assert made.host.status == "ready"


def test_another_protocol_is_refused_until_the_port_is_reopened() -> None:
    made = line(StandIn(major=2))
    assert made.run(10) is None
    assert made.host.refusal is not None
    assert FLASH_COMMAND in made.host.refusal
    assert made.host.status == made.host.refusal
    made.run(5_000)
    assert not made.host.wants_reopening
    assert made.device.setpoints == []
    made.device.major = 1
    made.host.closed("unplugged", made.now_us)
    assert made.host.status == "unplugged"
    made.open()
    assert made.host.refusal is None
    assert made.run(10) is not None


def test_a_closed_port_loses_the_device_at_once_and_gives_the_reason() -> None:
    made = streaming()
    made.host.exchange(0.001, made.now_us + 1)
    made.host.closed("unplugged", made.now_us)
    assert made.host.status == "unplugged"
    assert made.host.exchange(0.001, made.now_us) is None
    assert made.host.bytes_to_send() == b""
    made.device.reset(cause=1)
    made.open()
    assert made.run(10) is not None
    assert made.host.report()["times_lost"] == 1
    assert made.host.report()["resets_seen"] == 0  # the reset by opening is not counted
    made.host.closed("closed", made.now_us, orderly=True)
    assert made.host.report()["times_lost"] == 1


def test_late_readings_do_not_hide_that_hello_is_unanswered() -> None:
    made = streaming()
    made.host_hears = lambda _: b""
    made.run(100)
    made.host_hears = bytes
    made.device.period_ms = 1
    made.device_hears = lambda _: b""
    assert made.run(2_800) is None
    assert not made.host.wants_reopening
    assert made.run(400) is None
    assert made.host.wants_reopening
    assert "though it did before" in made.host.status


def test_the_devices_counters_are_accumulated_across_their_wrap() -> None:
    made = streaming()
    for _ in range(1000):
        made.device.refused += 3
        made.step()
    assert made.host.report()["device_messages_refused"] == 3000
    made.device.receive(b"xx\0" * 10)
    made.run(2)
    assert made.host.report()["device_frames_damaged"] == 10


def test_foreign_messages_are_counted() -> None:
    made = streaming()
    for body in (b"\x55hello", b"\x82\x00\x01", encode(Setpoint(1, 2, 3, 4))):
        made.host.receive(frame(body), made.now_us)
    assert made.host.report()["messages_unknown"] == 2
    assert made.host.report()["messages_malformed"] == 1
    assert made.run(1) is not None


BODIES = st.one_of(
    st.binary(min_size=1, max_size=LONGEST_BODY),
    *(
        st.binary(min_size=layout.size, max_size=layout.size).map(lambda rest, kind=kind: bytes((kind,)) + rest)
        for kind, (_, layout) in LAYOUTS.items()
    ),
    st.sampled_from([encode(StreamAck(1, 0)), encode(SensorReading(0, 0, 7, 65535, 255, 0, 0, 0, 0))]),
)
PIECES = st.one_of(st.binary(max_size=80), BODIES.map(frame))


@given(st.lists(st.tuples(PIECES, st.integers(-(10**7), 10**7), ANY, st.integers(0, 9)), max_size=40))
def test_no_input_raises(steps: list[tuple[bytes, int, float, int]]) -> None:
    host = WiredDevice(CALIBRATION)
    now_us = 0
    for data, elapsed_us, displacement_m, what in steps:
        now_us += elapsed_us
        if what == 0:
            host.opened(now_us)
        elif what == 1:
            host.closed("gone", now_us)
        host.receive(data, now_us)
        reading = host.exchange(displacement_m, now_us)
        assert reading is None or math.isfinite(reading.force_n + reading.displacement_m)
        host.bytes_to_send()
    host.report()


@given(
    st.builds(
        Identity,
        st.just(1),
        *[st.integers(0, 255)] * 5,
        st.just(7),
        st.integers(0, 2**32 - 1),
        *[st.integers(0, 65535)] * 7,
        st.integers(0, 255),
    ),
    st.lists(ANY, max_size=20),
)
def test_invalid_limits_never_raise(identity: Identity, displacements_m: list[float]) -> None:
    host = WiredDevice(CALIBRATION)
    host.opened(0)
    host.receive(frame(encode(identity)), 0)
    for ms, displacement_m in enumerate(displacements_m):
        reading = SensorReading(ms, ms, 7, 0, 1, ms, 0, 0, 0)
        host.receive(frame(encode(reading)), 1000 * ms)
        assert host.exchange(displacement_m, 1000 * ms) is not None
