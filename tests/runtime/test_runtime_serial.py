"""Serial ports on real pseudo-terminals, with a stand-in for the firmware at the other end."""

import asyncio
import contextlib
import errno
import os
import signal
import tty
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from hapticnet.device.calibration import Calibration
from hapticnet.device.wired import WiredDevice
from hapticnet.errors import RefusedError, SettingsError, UnavailableError
from hapticnet.runtime import serial_port
from hapticnet.runtime.serial_port import (
    SerialPort,
    SerialSpec,
    Wire,
    choose_port,
    find_ports,
    parse_serial,
    run_device,
)
from hapticnet.runtime.system import loop_factory, now_us
from hapticnet.runtime.timer import Ticker
from tests.device.standin import StandIn
from tests.runtime.plugged import Plugged

CALIBRATION = Calibration(counts=(100.0, 900.0), forces_n=(0.2, 5.0))
PATIENCE_S = 20.0


class Driven:
    """A serial port with a device, driven like by a master."""

    def __init__(self, spec: SerialSpec) -> None:
        loop = asyncio.get_running_loop()
        self.wired = WiredDevice(CALIBRATION)
        self.port = SerialPort(loop, spec, self.wired)
        self.displacement_m = 0.0
        self._ticker = Ticker(loop, 1000, self._tick)

    def _tick(self, now: int) -> None:
        self.reading = self.wired.exchange(self.displacement_m, now)
        self.port.flush(now)

    async def until(self, condition: Callable[[], bool]) -> int:
        """Wait for a condition; return the time this took [µs]."""
        start_us = now_us()
        while not condition():
            assert now_us() - start_us < PATIENCE_S * 1e6, self.wired.status
            await asyncio.sleep(0.001)
        return now_us() - start_us

    async def ready(self) -> None:
        await self.until(lambda: self.wired.status == "ready")

    async def stop(self) -> None:
        self._ticker.stop()
        await self.port.stop()


def play(scene, make_loop=loop_factory()):  # noqa: B008
    """Run a coroutine function on a new loop."""
    with asyncio.Runner(loop_factory=make_loop) as runner:
        return runner.run(asyncio.wait_for(scene(), 60))


def play_plugged_in(scene, make_loop=loop_factory()):  # noqa: B008
    """Run a coroutine function of a stand-in that is plugged in, and of what drives it; return the latter."""

    async def whole():
        plugged = Plugged(StandIn())
        driven = Driven(SerialSpec(plugged.path))
        try:
            await scene(plugged, driven)
        finally:
            await driven.stop()
            plugged.unplug()
        return driven

    return play(whole, make_loop)


BOTH_LOOPS = pytest.mark.parametrize("make_loop", [None, loop_factory()], ids=["asyncio", "uvloop"])


@BOTH_LOOPS
def test_opens_streams_and_moves_although_a_pty_has_no_low_latency_mode(make_loop):
    async def scene(plugged, driven):
        await driven.ready()
        plugged.firmware.adc = 300 * 64
        driven.displacement_m = 0.003
        await driven.until(lambda: bool(driven.reading) and driven.reading.adc == 300.0)
        await driven.until(lambda: plugged.firmware.servos.displacement_m > 0.0029)
        await driven.until(lambda: bool(driven.reading) and driven.reading.displacement_m > 0.0029)

    driven = play_plugged_in(scene, make_loop)
    assert driven.wired.status == "ready"
    assert driven.wired.exchange(0.0, now_us()) is None
    assert driven.port.openings == 1
    assert driven.port.unwritten == 0


@pytest.mark.parametrize("hangs_up", [False, True])
@BOTH_LOOPS
def test_unplugging_is_detected_and_reported(make_loop, hangs_up):
    """No limits on time here; the reason must be the hang-up itself, not the silence after it."""

    async def scene(plugged, driven):
        await driven.ready()
        if hangs_up:
            plugged.hang_up()
        else:
            plugged.unplug()
        await driven.until(lambda: driven.wired.status != "ready")
        assert driven.wired.status == "unplugged"
        assert driven.wired.exchange(0.001, now_us()) is None

    try:
        play_plugged_in(scene, make_loop)
    except PermissionError:
        pytest.skip("hanging up a terminal takes CAP_SYS_ADMIN")


def test_an_automatically_found_port_is_found_again_elsewhere(monkeypatch):
    async def scene():
        first, second = Plugged(StandIn()), Plugged(StandIn())
        monkeypatch.setattr(serial_port, "choose_port", lambda: first.path)
        driven = Driven(SerialSpec(None))
        await driven.ready()
        first.unplug()
        monkeypatch.setattr(serial_port, "choose_port", lambda: second.path)
        await driven.until(lambda: driven.port.openings == 2)
        await driven.ready()
        await driven.stop()
        second.unplug()

    play(scene)


def test_the_port_of_a_silent_device_is_reopened():
    async def scene(_, driven):
        await driven.ready()
        driven.wired.wants_reopening = True  # as after three seconds of silence
        await driven.until(lambda: driven.port.openings == 2)
        await driven.ready()

    play_plugged_in(scene)


def test_a_port_that_accepts_nothing_never_blocks():
    async def scene():
        master, slave = os.openpty()
        tty.setraw(slave)
        driven = Driven(SerialSpec(os.ttyname(slave)))
        await driven.until(lambda: driven.port.openings == 1)
        driven.wired.bytes_to_send = lambda: b"x" * 1000  # not read at the other end
        await driven.until(lambda: driven.port.unwritten > 10_000)
        driven.wired.bytes_to_send = lambda: b""
        written = 0
        os.set_blocking(master, False)
        for _ in range(100):
            with contextlib.suppress(BlockingIOError):
                written += os.read(master, 65536).count(b"x")
            await asyncio.sleep(0.001)
        await driven.stop()
        os.close(slave)
        os.close(master)
        return written

    # A frame is written completely or not at all.
    assert play(scene) % 1000 == 0


def test_waiting_for_a_device_reports_why_there_is_none(tmp_path):
    async def wait_for(path, within_s):
        port = SerialPort(asyncio.get_running_loop(), SerialSpec(path), WiredDevice(CALIBRATION))
        try:
            await port.wait_ready(within_s)
        finally:
            await port.stop()

    async def refused():
        plugged = Plugged(StandIn(major=9))
        try:
            await wait_for(plugged.path, PATIENCE_S)
        finally:
            plugged.unplug()

    master, slave = os.openpty()
    with pytest.raises(RefusedError, match="make -C firmware flash"):
        play(refused)
    with pytest.raises(UnavailableError, match=r"ttyUSB7 is missing.*hapticnet device find"):
        play(lambda: wait_for(str(tmp_path / "ttyUSB7"), PATIENCE_S))
    with pytest.raises(UnavailableError, match="HELLO"):
        play(lambda: wait_for(os.ttyname(slave), 0.2))
    os.close(slave)
    os.close(master)


def test_the_reason_why_a_port_cannot_be_opened_is_explained(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    master, slave = os.openpty()
    path = os.ttyname(slave)
    held = serial_port._open(SerialSpec(path))
    cases = [(str(file), "not a serial port"), (str(tmp_path), "not a serial port"), (path, "in use")]
    for bad, words in cases:
        with pytest.raises(UnavailableError, match=words):
            serial_port._open(SerialSpec(bad))
    held.close()
    os.close(slave)
    os.close(master)

    def denied(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(serial_port.serial, "Serial", denied)
    with pytest.raises(UnavailableError, match="group dialout"):
        serial_port._open(SerialSpec(path))


def test_a_serial_device_is_specified_by_its_port():
    assert parse_serial("serial:auto") == SerialSpec(None)
    for text in ("serial:auto", "serial:/dev/ttyACM1"):
        assert str(parse_serial(text)) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("serial:", "serial:auto"),
        ("/dev/ttyUSB0", "serial:auto"),
        ("serial:ttyUSB0", "/dev/ttyUSB0"),
    ],
)
def test_an_invalid_serial_device_is_explained(text, words):
    with pytest.raises(SettingsError, match=words):
        parse_serial(text)


def usb(device, vendor, description="USB Serial", number=None):
    return SimpleNamespace(device=str(device), vid=vendor, description=description, serial_number=number)


def test_ports_are_found_by_id_and_likely_ones_first(tmp_path, monkeypatch):
    for name in ("ttyS0", "ttyUSB0", "ttyUSB1"):
        (tmp_path / name).touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-FTDI-if00").symlink_to(tmp_path / "ttyUSB1")
    ports = [
        usb(tmp_path / "ttyS0", None),
        usb(tmp_path / "ttyUSB0", 0x10C4),
        usb(tmp_path / "ttyUSB1", 0x0403, "FT", "A1"),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    monkeypatch.setattr(serial_port, "BY_ID", by_id)
    found = find_ports()
    assert [port.path for port in found] == [
        str(by_id / "usb-FTDI-if00"),
        str(tmp_path / "ttyS0"),
        str(tmp_path / "ttyUSB0"),
    ]
    assert found[0].name == str(tmp_path / "ttyUSB1")
    assert found[0].serial_number == "A1"
    assert "FTDI" in str(found[0].likely)
    assert found[1].likely is None
    assert choose_port() == found[0].path


def test_auto_without_a_single_candidate_lists_the_choices(monkeypatch, tmp_path):
    monkeypatch.setattr(serial_port, "BY_ID", tmp_path / "none")
    monkeypatch.setattr(list_ports, "comports", list)
    with pytest.raises(UnavailableError, match=r"Is it plugged in.*none"):
        choose_port()
    monkeypatch.setattr(list_ports, "comports", lambda: [usb("/dev/ttyS0", None)])
    with pytest.raises(UnavailableError, match="serial:/dev/ttyS0"):
        choose_port()
    monkeypatch.setattr(list_ports, "comports", lambda: [usb("/dev/ttyUSB0", 0x1A86), usb("/dev/ttyUSB1", 0x2341)])
    with pytest.raises(UnavailableError, match=r"2 ports.*serial:/dev/ttyUSB0, serial:/dev/ttyUSB1"):
        choose_port()


@pytest.fixture(autouse=True)
def own_signals():
    """Give this process the handlers back that a device that is run replaces."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def run_on_stand_in(tick):
    async def scene():
        plugged = Plugged(StandIn())
        wired = WiredDevice(CALIBRATION)
        try:
            wire = Wire(wired=wired, spec=SerialSpec(plugged.path))
            return await run_device(wire, lambda now: tick(wired, now))
        finally:
            plugged.unplug()

    return play(scene)


def test_a_device_is_run_until_its_tick_is_done():
    readings = []

    def tick(wired, now):
        readings.append(wired.exchange(0.001, now))
        return len(readings) == 50

    assert run_on_stand_in(tick) is True
    assert len(readings) == 50
    assert all(reading is not None for reading in readings[:1])


def test_an_exception_in_a_tick_ends_the_run():
    def tick(*_):
        raise SettingsError("no more")

    with pytest.raises(SettingsError, match="no more"):
        run_on_stand_in(tick)
