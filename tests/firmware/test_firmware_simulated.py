"""The compiled firmware on a simulated ATmega328P in virtual time."""

import random
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from hapticnet.device.messages import ADC_FRACTION, Flag, Hello, Identity, SensorReading, Setpoint, Stream, StreamAck
from hapticnet.device.servos import Linkage
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.runtime.nano import BUILD_VARIABLE, CYCLES_PER_US, Simavr, simavr_build
from tests.firmware.rig import HANG

RETRACTED_US = Linkage().retracted_us
EDGE_ERROR_US = 2.0
TWO_BYTES_US = 2 * 10 / 0.5  # at 500 kbaud


def near(width_us: float) -> Any:
    return pytest.approx(width_us, abs=EDGE_ERROR_US)


def drive(nano: Any, frames: int, *pulses: int, period_us: int = 10_000) -> None:
    for sequence in range(frames * 20_000 // period_us):
        nano.advance(period_us, Setpoint(sequence, *pulses))


@pytest.mark.usefixtures("needs_toolchain")
def test_flash_and_ram_are_at_most_half_full(make_firmware: Callable[..., Path]) -> None:
    report = (make_firmware("firmware") / "firmware.log").read_text()
    flash, ram = map(float, re.findall(r"\(([\d.]+) %\)", report))
    assert 0.0 < flash <= 50.0
    assert 0.0 < ram <= 50.0


def test_it_starts_retracted_and_keeps_a_50_hz_frame(nano: Any) -> None:
    device = nano()
    device.advance(500_000)
    assert {pulse.servo for pulse in device.pulses} == {0, 1, 2}
    assert all(pulse.width_us == near(RETRACTED_US) for pulse in device.pulses)
    starts_us = [pulse.start_us for pulse in device.pulses if pulse.servo == 1]
    assert len(starts_us) >= 24
    for before, after in pairwise(starts_us):
        assert after - before == near(20_000)
    assert device.pulses[0].start_us < 15_000


def test_every_edge_is_within_2_us_under_full_traffic(nano: Any) -> None:
    device = nano()
    device.boot_and_greet()
    device.advance(1_000, Stream(1))
    drive(device, 20, 2400, 2400, 2400, period_us=1_000)
    chance = random.Random(5)
    for _ in range(20):
        pulses = [chance.randint(2360, 4040) for _ in range(3)]
        drive(device, 16, *pulses, period_us=1_000)
        device.pulses.clear()
        drive(device, 5, *pulses, period_us=1_000)
        assert len(device.pulses) >= 12
        for pulse in device.pulses:
            assert pulse.width_us == near(pulses[pulse.servo] / 2)


def test_no_interrupt_waits_longer_than_two_byte_times(nano: Any) -> None:
    device = nano()
    device.boot_and_greet()
    device.advance(1_000, Stream(1))
    for sequence in range(2_000):
        step = device.advance(1_000, Setpoint(sequence, 2400 + sequence % 1000, 3500, 2900))
    assert 0 < step.latency_cycles / CYCLES_PER_US <= TWO_BYTES_US


@pytest.mark.parametrize("sequence", [HANG, HANG + 1, HANG + 2], ids=["main loop", "all of it", "servo frames"])
@pytest.mark.parametrize("phase_us", [0, 6_000, 13_000])
def test_hung_firmware_is_reset_and_retracts_within_150_ms(nano: Any, sequence: int, phase_us: int) -> None:
    device = nano(target="test-firmware", elf="hanging.elf")
    device.boot_and_greet()
    drive(device, 12, 3600, 3600, 3600)
    device.advance(phase_us)
    device.advance(1_000, Setpoint(sequence, 3600, 3600, 3600))
    hung_us = device.now_us
    resets = 0
    while resets == 0:
        resets = device.advance(1_000).resets
        assert device.now_us - hung_us < 150_000
    device.pulses.clear()
    device.advance(150_000 - int(device.now_us - hung_us))
    assert {pulse.servo for pulse in device.pulses} == {0, 1, 2}
    assert all(pulse.width_us == near(RETRACTED_US) for pulse in device.pulses)
    device.advance(5_000, Hello())
    before, after = device.of_kind(Identity)
    assert before.reset_cause & 1
    assert (before.boot_id, after.boot_id) == (1, 2), "the ELF has an EEPROM of zeros"
    assert after.reset_cause == 8


def test_the_environment_variable_sets_the_folder_of_the_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnavailableError, match="make -C firmware sim"):
        Simavr(tmp_path / "harness", tmp_path / "firmware.elf")
    monkeypatch.setenv(BUILD_VARIABLE, str(tmp_path))
    for name in ("harness", "firmware.elf"):
        with pytest.raises(UnavailableError, match=rf"{name} is missing.*make simulator"):
            simavr_build()
        (tmp_path / name).touch()
    assert simavr_build() == (tmp_path / "harness", tmp_path / "firmware.elf")


def test_the_default_build_is_that_of_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(BUILD_VARIABLE, raising=False)
    monkeypatch.setattr(Path, "is_file", lambda _: True)
    assert [path.parent for path in simavr_build()] == [Path(__file__).parents[2] / "firmware" / "build"] * 2


@pytest.mark.parametrize(("duration_us", "data"), [(-1, b""), (10_000_001, b""), (1_000, bytes(65_536))])
def test_a_step_too_large_for_the_harness_is_refused(nano: Any, duration_us: int, data: bytes) -> None:
    with pytest.raises(SettingsError, match=r"between 0 and 10000000|the limit is 65535"):
        nano().simavr.advance(duration_us, data=data)


def test_readings_are_the_mean_of_the_last_millisecond(nano: Any) -> None:
    device = nano()
    device.boot_and_greet()
    device.advance(1_000, Stream(1), millivolts=1000)
    assert device.of_kind(StreamAck) == [StreamAck(1, 1)]
    for millivolts in (0.0, 1000.0, 2500.0, 4900.0):
        device.advance(5_000, millivolts=millivolts)
        device.messages.clear()
        device.advance(20_000, millivolts=millivolts)
        readings = device.messages
        assert len(readings) >= 19
        count = int(millivolts * 1024 / 5000)
        assert {reading.adc for reading in readings} == {count * ADC_FRACTION}
        for before, after in pairwise(readings):
            assert after.uptime_ms == before.uptime_ms + 1
            assert after.sequence == before.sequence + 1


def test_readings_keep_the_fraction_of_a_count(nano: Any) -> None:
    device = nano()
    device.boot_and_greet()
    device.advance(1_000, Stream(1))
    for half_ms in range(40):
        device.advance(500, millivolts=2501.0 + 5.0 * (half_ms % 2))
    settled = [reading.adc / ADC_FRACTION for reading in device.of_kind(SensorReading)[2:]]
    assert settled
    assert all(512.3 < adc < 512.7 for adc in settled)


def test_ten_thousand_bytes_of_garbage_move_nothing_and_hello_is_still_received(nano: Any) -> None:
    device = nano()
    device.advance(device.BOOT_US)
    chance = random.Random(1)
    drive(device, 10, 3000, 3000, 3000)
    for _ in range(40):
        device.advance(10_000, data=chance.randbytes(450))
    assert device.sent == b""
    device.advance(5_000, data=b"\0")
    device.advance(5_000, Hello())
    device.advance(10_000, Stream(1))
    assert len(device.of_kind(Identity)) == 1
    reading = device.messages[-1]
    assert reading.flags == Flag.GREETED | Flag.RETRACTED
    assert reading.damaged > 0
    assert reading.overruns == 0
    assert all(pulse.width_us == near(RETRACTED_US) for pulse in device.pulses)


def test_a_flood_affects_neither_pulses_nor_the_watchdog(nano: Any) -> None:
    device = nano()
    device.boot_and_greet()
    for _ in range(30):
        step = device.advance(10_000, data=b"\x05abcd" * 90)
    assert step.resets == 0
    assert len(device.pulses) >= 3 * 15
