"""The firmware's core, compiled for the host under sanitizers: protocol and limits."""

import json
import random
from pathlib import Path
from typing import Any

import pytest

from hapticnet.device.messages import (
    LAYOUTS,
    LONGEST_BODY,
    LONGEST_FRAME,
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    TICKS_PER_US,
    Deframer,
    Flag,
    Hello,
    Identity,
    SensorReading,
    Setpoint,
    Stream,
    StreamAck,
    encode,
    frame,
)
from hapticnet.device.servos import Linkage

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "device.json").read_text())
LINKAGE = Linkage()
RETRACTED = [int(LINKAGE.retracted_us * TICKS_PER_US)] * 3
LEVEL = Setpoint(7, 3000, 3000, 3000)
STEP = 120
FRAME_MS = 20


@pytest.fixture
def greeted(core: Any) -> Any:
    core.send(0, Hello())
    return core


@pytest.mark.parametrize("vector", VECTORS["messages"], ids=lambda vector: vector["name"])
def test_c_and_python_agree_on_every_message(core: Any, vector: dict[str, Any]) -> None:
    if vector["kind"] < 0x80:
        assert core("decode", vector["body"]) == " ".join(map(str, [vector["kind"], *vector["fields"]]))
    else:
        assert core("encode", vector["kind"], *vector["fields"]) == vector["frame"]


@pytest.mark.parametrize("vector", VECTORS["damaged"], ids=lambda vector: vector["name"])
def test_c_drops_what_python_drops(core: Any, vector: dict[str, str]) -> None:
    assert core("receive", 0, vector["frame"]) == ""
    assert core("damaged") == "1"


def test_a_message_of_the_wrong_length_is_refused(core: Any) -> None:
    for kind, (_, layout) in LAYOUTS.items():
        for length in range(LONGEST_BODY):
            taken = core("decode", (bytes((kind,)) + bytes(length)).hex()) != ""
            assert taken == (kind < 0x80 and length == layout.size)


def test_ten_thousand_bytes_of_garbage_are_counted_as_in_python(core: Any) -> None:
    chance = random.Random(3)
    python = Deframer()

    def damaged_frame() -> bytes:
        piece = bytearray(frame(chance.randbytes(chance.randint(1, 12))))
        for _ in range(chance.randint(0, 3)):
            piece[chance.randrange(len(piece))] = chance.randrange(256)
        return bytes(piece[: chance.randint(1, len(piece))]) + chance.randbytes(chance.choice((0, 0, 2, 90)))

    for _ in range(150):
        data = b"".join(damaged_frame() + b"\0" for _ in range(100))
        python.feed(data)
        assert core.receive(0, data) == []
        assert int(core("damaged")) == python.damaged % 256
    assert python.damaged > 10_000
    (identity,) = core.send(0, Hello())
    assert isinstance(identity, Identity)


def test_hello_is_answered_with_the_limits(core: Any) -> None:
    (identity,) = core.send(5, Hello())
    assert identity[:2] == (PROTOCOL_MAJOR, PROTOCOL_MINOR)
    assert identity.clock_hz == 16_000_000
    assert identity.adc_bits == 10
    assert identity.largest_step == STEP
    # The whole travel, plus two deadbands for a servo that moves ahead of the others.
    slack_us = 2 * LINKAGE.deadband_us
    for shortest, longest in identity.pulse_limits:
        assert shortest <= (LINKAGE.retracted_us - slack_us) * TICKS_PER_US
        assert longest >= (LINKAGE.extended_us + slack_us) * TICKS_PER_US


def test_nothing_is_done_before_hello(core: Any) -> None:
    assert core.send(0, LEVEL) == []
    assert core.send(0, Stream(1)) == []
    assert core.frame(0) == RETRACTED
    core.send(1, Hello())
    core.send(1, Stream(1))
    (reading,) = core.tick(2)
    assert reading.refused == 2
    assert reading.flags == Flag.GREETED | Flag.RETRACTED


def test_a_host_of_another_major_gets_the_identity_and_is_refused(greeted: Any) -> None:
    (identity,) = greeted.send(0, Hello(PROTOCOL_MAJOR + 1, 0))
    assert identity.protocol_major == PROTOCOL_MAJOR
    greeted.send(0, LEVEL)
    assert greeted.frame(0) == RETRACTED
    assert greeted.send(0, Stream(1)) == []


def test_the_newest_setpoint_wins_and_is_reached_in_steps(greeted: Any) -> None:
    greeted.send(0, Stream(1))
    greeted.send(0, Setpoint(1, 3900, 3900, 3900))
    greeted.send(1, Setpoint(2, 2500, 2600, 2405))
    assert greeted.frame(2) == [2500, 2400 + STEP, 2405]
    assert greeted.tick(3)[0].flags == Flag.GREETED | Flag.STEP_LIMITED
    assert greeted.frame(22) == [2500, 2600, 2405]
    (reading,) = greeted.tick(23)
    assert reading.flags == Flag.GREETED
    assert reading.applied_sequence == 2


def test_motion_away_from_the_finger_is_not_limited(greeted: Any) -> None:
    for now_ms in range(0, 10 * FRAME_MS, FRAME_MS):
        greeted.send(now_ms, LEVEL)
        held = greeted.frame(now_ms)
    assert held == list(LEVEL[1:])
    greeted.send(200, Setpoint(8, 2400, 2881, 2880))
    assert greeted.frame(200) == [2400, 2881, 2880]


@pytest.mark.parametrize("servo", [0, 1, 2])
@pytest.mark.parametrize(("ticks", "taken"), [(0, 0), (2359, 0), (2360, 1), (4040, 1), (4041, 0), (65535, 0)])
def test_a_setpoint_beyond_the_limits_of_one_servo_is_refused_as_a_whole(
    greeted: Any, servo: int, ticks: int, taken: int
) -> None:
    pulses = [2410, 2420, 2430]
    pulses[servo] = ticks
    greeted.send(0, Setpoint(1, *pulses))
    assert (greeted.frame(0) != RETRACTED) == bool(taken)


@pytest.mark.parametrize("start_ms", [0, 1_000, 2**32 - 100], ids=["at start", "later", "across the wrap of the clock"])
def test_silence_retracts_in_one_frame_and_a_new_setpoint_starts_softly(core: Any, start_ms: int) -> None:
    def at(ms: int) -> int:
        return (start_ms + ms) % 2**32

    core("start", start_ms)
    core.send(at(0), Hello())
    core.send(at(0), LEVEL)
    for ms in range(0, 180, FRAME_MS):
        core.frame(at(ms))
    assert core.frame(at(189)) == list(LEVEL[1:])
    assert core.frame(at(190)) == RETRACTED
    core.send(at(230), LEVEL)
    assert core.frame(at(232)) == [2400 + STEP] * 3


def test_refused_and_damaged_setpoints_are_not_a_sign_of_life(greeted: Any) -> None:
    greeted.send(0, LEVEL)
    for now_ms in range(0, 200, 10):
        greeted.send(now_ms, Setpoint(1, 0, 0, 0))
        greeted.receive(now_ms, frame(encode(LEVEL))[1:])
        greeted.send(now_ms, Stream(0))
    assert greeted.frame(200) == RETRACTED


def test_hello_retracts_and_stops_the_stream(greeted: Any) -> None:
    greeted.send(0, Stream(1))
    greeted.send(0, LEVEL)
    assert greeted.frame(0) != RETRACTED
    greeted.send(1, Hello())
    assert greeted.frame(20) == RETRACTED
    assert greeted.tick(21) == []


def test_readings_come_at_the_requested_period(greeted: Any) -> None:
    assert greeted.tick(0) == []
    assert greeted.send(0, Stream(3)) == [StreamAck(3, 3)]
    readings = [reading for ms in range(1, 31) for reading in greeted.tick(ms, 64 * ms)]
    assert [reading.uptime_ms for reading in readings] == list(range(3, 31, 3))
    assert [reading.sequence for reading in readings] == list(range(10))
    assert readings[-1] == SensorReading(9, 30, 7, 64 * 30, Flag.GREETED | Flag.RETRACTED, 0, 0, 0, 0)
    assert greeted.send(40, Stream(0)) == [StreamAck(0, 0)]
    assert greeted.tick(41) == []


def test_the_watchdog_is_not_reset_without_servo_frames(core: Any) -> None:
    core.frame(100)
    assert core("alive", 140) == "1"
    assert core("alive", 141) == "0"


def test_the_longest_frame_fits_and_one_byte_more_does_not(core: Any) -> None:
    assert core.receive(0, frame(bytes(LONGEST_BODY))) == []
    assert core("damaged") == "0"
    assert len(frame(bytes(LONGEST_BODY))) == LONGEST_FRAME + 1
    core.receive(0, frame(bytes(LONGEST_BODY + 1)))
    assert core("damaged") == "1"


def test_pulses_keep_their_range_and_step_whatever_the_host_sends(core: Any) -> None:
    chance = random.Random(11)
    core.send(0, Hello())
    now_ms = 0
    held = RETRACTED
    moved = 0
    for _ in range(2_000):
        for _ in range(chance.randint(0, 2)):
            lowest, highest = chance.choice(((0, 65535), (2300, 4100), (2360, 4040)))
            core.send(now_ms, Setpoint(1, *(chance.randint(lowest, highest) for _ in range(3))))
        now_ms += chance.choice((20, 20, 20, 20, 250))
        before, held = held, core.frame(now_ms)
        moved += held != before
        assert all(2360 <= pulse <= 4040 for pulse in held)
        assert held == RETRACTED or all(now - then <= STEP for now, then in zip(held, before, strict=True))
    assert moved > 1_000
