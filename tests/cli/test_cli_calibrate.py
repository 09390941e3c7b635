"""Calibrating: what measured pairs become, and the guided way without a terminal."""

import asyncio
import datetime
import json
import os
import subprocess
import sys
import threading
import time
from queue import Queue

import pytest

from hapticnet.cli.device import calibrate as measuring
from hapticnet.cli.device.calibrate import WINDOW_US, CalibrationSession, calibrate
from hapticnet.device.messages import ADC_FRACTION
from hapticnet.device.profile import MeasuredFinger, Profile, dump_profile, load_profile
from hapticnet.device.simulated import Sensor
from hapticnet.errors import SettingsError
from tests.device.standin import StandIn
from tests.ready import ROOT
from tests.runtime.plugged import Plugged

FORCES_N = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 3.0, 2.0, 1.0, 0.5)


MEASURED = [(force_n, Sensor().counts(force_n)) for force_n in FORCES_N] + [(60.0, 1023.0)]


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Work in a folder of its own, on a device that gives these pairs, which a test may change."""
    pairs = list(MEASURED)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(measuring, "_measure", lambda _: pairs)
    monkeypatch.setattr(measuring, "_serial_number", lambda _: None)
    return pairs


@pytest.mark.usefixtures("measured")
def test_measured_pairs_become_a_profile(tmp_path, capsys):
    calibrate()
    profile = load_profile(tmp_path / "device.toml")
    assert profile.calibration is not None
    assert profile.calibration.pairs == len(FORCES_N)
    assert profile.calibration.residual_rms_n < 1e-9
    written = datetime.date.fromisoformat(profile.calibration.date)
    assert datetime.timedelta(0) <= datetime.date.today() - written <= datetime.timedelta(1)
    for force_n in FORCES_N:
        assert profile.table.force_n(Sensor().counts(force_n)) == pytest.approx(force_n)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["pair", "force", "[N]", "adc", "table", "[N]", "residual", "[N]"]
    assert lines[3].split() == ["3", "1.000", "525.1", "1.000", "+0.000"]
    assert lines[11].split() == ["11", "60.000", "1023.0", "saturated", "–"]
    assert not any("the device renders" in line for line in lines)
    assert lines[-1] == "written to device.toml"


def test_a_calibration_that_ends_below_what_the_device_renders_says_so(measured, capsys):
    measured[:] = [(0.5, 353.0), (1.0, 525.0), (2.0, 694.0)]
    calibrate()
    assert "the device renders up to 5 N, but above 2 N this table is constant" in capsys.readouterr().out


def test_for_a_program_the_same_comes_as_json(measured, tmp_path, capsys):
    calibrate(out=tmp_path / "other.toml", json=True)
    report = json.loads(capsys.readouterr().out)
    assert report["saturated"] == 1
    assert report["hysteresis"] == pytest.approx(0.0, abs=1e-9)
    assert [(pair["force_n"], pair["adc"]) for pair in report["pairs"]] == measured
    assert report["pairs"][-1]["residual_n"] is None
    calibration = load_profile(tmp_path / "other.toml").table
    assert tuple(knot["adc"] for knot in report["knots"]) == calibration.counts
    assert [knot["force_n"] for knot in report["knots"]] == pytest.approx(calibration.forces_n)


@pytest.mark.usefixtures("measured")
def test_a_profile_gone_on_from_keeps_what_else_it_knows(tmp_path):
    file = tmp_path / "mine.toml"
    finger = MeasuredFinger(stiffness_n_m=900.0, contact_m=0.002, date="2026-05-04")
    file.write_text(dump_profile(Profile(serial="A9B0C1D2", finger=finger, servo_lag_s=0.03)))
    calibrate(profile=file)
    profile = load_profile(file)
    assert (profile.serial, profile.finger, profile.servo_lag_s) == ("A9B0C1D2", finger, 0.03)
    assert not profile.is_generic


@pytest.mark.usefixtures("measured")
def test_a_profile_is_not_overwritten_unasked(tmp_path):
    calibrate()
    before = (tmp_path / "device.toml").read_text()
    with pytest.raises(
        SettingsError, match=r"device.toml exists; update it with --profile device.toml or choose another file"
    ):
        calibrate()
    assert (tmp_path / "device.toml").read_text() == before
    calibrate(profile=tmp_path / "device.toml")


def test_pairs_that_make_no_calibration_are_refused_and_nothing_is_written(measured, tmp_path):
    measured[:] = [(1.0, 500.0), (2.0, 400.0)]
    with pytest.raises(SettingsError, match="the force does not increase with the counts"):
        calibrate()
    assert not (tmp_path / "device.toml").exists()


def measure(session, typed, counts, now_us=0):
    """Type a line, then let the readings come, one a millisecond; return all that is said."""
    said = [session.typed(typed, now_us)]
    said += [session.read(adc, now_us + 1000 * (index + 1)) for index, adc in enumerate(counts)]
    return [each for each in said if each is not None]


def test_each_force_typed_is_paired_with_half_a_second_of_readings():
    session = CalibrationSession()
    assert session.read(999.0, 0) is None
    assert measure(session, "1.5", [500.0, 502.0] * (WINDOW_US // 2000)) == ["pair 1: 1.5 N, 501.0 counts"]
    assert session.read(999.0, 10**6) is None
    assert measure(session, " 2 ", [600.0] * 600, 2 * 10**6) == ["pair 2: 2 N, 600.0 counts"]
    assert session.pairs == [(1.5, 501.0), (2.0, 600.0)]
    assert not session.finished
    session.typed("\n", 0)
    assert session.finished


@pytest.mark.parametrize("line", ["two", "1,5", "nan", "inf", "-1", "150", "1e300", "x" * 1000])
def test_what_is_no_force_is_asked_for_again(line):
    session = CalibrationSession()
    said = measure(session, line, [500.0] * 1000)
    assert len(said) == 1
    assert "is not a force between 0 and 100 N" in said[0]
    assert len(said[0]) < 100
    assert session.pairs == []


def test_what_is_typed_while_measuring_does_not_disturb_the_measurement():
    session = CalibrationSession()
    assert measure(session, "1", [500.0] * 100) == []
    assert session.typed("2", 100_000) == "still measuring the last force; keep holding it"
    assert session.typed("", 100_000) is None  # the end
    assert not session.finished
    said = [session.read(500.0, 101_000 + 1000 * index) for index in range(500)]
    assert [each for each in said if each] == ["pair 1: 1 N, 500.0 counts"]
    assert session.finished


def test_a_device_lost_meanwhile_costs_only_that_pair():
    session = CalibrationSession()
    (said,) = measure(session, "1", [500.0, None, 500.0] * 300)
    assert "lost" in said
    assert session.pairs == []
    assert len(measure(session, "1", [500.0] * 500, 10**6)) == 1
    assert session.pairs == [(1.0, 500.0)]


def test_a_saturated_pair_is_said_to_be_one_and_a_clock_that_leaps_ends_a_measurement():
    session = CalibrationSession()
    assert measure(session, "30", [1023.0] * 500) == ["pair 1: 30 N, 1023.0 counts (saturated: will be ignored)"]
    session.typed("1", 10**6)
    assert session.read(500.0, 1 << 60) == "pair 2: 1 N, 500.0 counts"


@pytest.fixture
def plugged():
    """Return a stand-in for the device and the pseudo-terminal it is on."""
    firmware, ports, ended = StandIn(), Queue(), threading.Event()

    async def live():
        device = Plugged(firmware)
        ports.put(device.path)
        while not ended.is_set():
            await asyncio.sleep(0.01)
        device.unplug()

    thread = threading.Thread(target=lambda: asyncio.run(live()))
    thread.start()
    yield firmware, ports.get()
    ended.set()
    thread.join()


@pytest.fixture
def guided(plugged, tmp_path):
    """Return a running guided calibration, its device, and what it is to write."""
    firmware, port = plugged
    file = tmp_path / "device.toml"
    code = f"from hapticnet.cli.device.calibrate import calibrate; calibrate('serial:{port}')"
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, "-c", code], text=True, cwd=tmp_path, env=environment, **pipes)
    yield process, firmware, file
    process.kill()
    process.communicate()


def test_the_guided_way_on_a_device(guided):
    process, firmware, file = guided
    assert "keep fingers out" in process.stderr.readline()
    for number, (force_n, adc) in enumerate(((0.5, 350), (1.0, 520), (2.0, 690)), start=1):
        said = ""
        while f"pair {number}: {force_n:g} N" not in said:  # a busy machine may lose the device, and says so
            firmware.adc = adc * ADC_FRACTION
            time.sleep(0.05)
            process.stdin.write(f"{force_n}\n")
            process.stdin.flush()
            said = process.stderr.readline()
            assert said
    table, _ = process.communicate("\n", timeout=20)
    assert process.returncode == 0
    assert table.splitlines()[-1] == "written to device.toml"
    profile = load_profile(file)
    assert profile.calibration is not None
    assert profile.calibration.pairs == 3
    assert profile.table.counts == pytest.approx((350, 520, 690), abs=10)
    assert profile.table.forces_n == pytest.approx((0.5, 1.0, 2.0), rel=0.05)
    # Nobody was pressed meanwhile.
    assert firmware.held == (2400, 2400, 2400)


def test_a_signal_ends_the_guided_way_and_writes_nothing(guided):
    process, _, file = guided
    process.stderr.readline()
    process.stderr.read(1)  # the prompt, so it listens
    process.terminate()
    process.communicate(timeout=20)
    assert process.returncode != 0
    assert not file.exists()
