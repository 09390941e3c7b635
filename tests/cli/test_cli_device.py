"""``hapticnet device find`` and ``info``: on a pseudo-terminal, and on what is no device."""

import asyncio
import json
import os
import sys
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from hapticnet.cli.device.wired import find
from hapticnet.device.messages import PROTOCOL_MAJOR
from hapticnet.device.profile import load_profile
from hapticnet.runtime import serial_port
from tests.cli.test_cli_errors import UNAVAILABLE, WRONG_SETTINGS, assert_one_line
from tests.device.standin import StandIn
from tests.ready import ROOT, hapticnet
from tests.runtime.plugged import Plugged


def on_stand_in(firmware, *arguments):
    """Run a verb on a stand-in; {} in its arguments is the port. Returns what subprocess.run would."""

    async def scene():
        plugged = Plugged(firmware)
        filled = [str(argument).format(plugged.path) for argument in arguments]
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "hapticnet", "device", *filled),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )
        try:
            stdout, stderr = await process.communicate()
        finally:
            plugged.unplug()
        return SimpleNamespace(returncode=process.returncode, stdout=stdout.decode(), stderr=stderr.decode())

    return asyncio.run(asyncio.wait_for(scene(), 60))


def test_info_says_who_answers():
    done = on_stand_in(StandIn(boot_id=41, reset_cause=4), "info", "serial:{}", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["firmware"] == "0.1.0"
    assert said["protocol"].startswith(f"{PROTOCOL_MAJOR}.")
    assert said["boot_id"] == 41
    assert said["reset_cause"] == "brown-out"
    assert said["stream_period_ms"] == 2
    assert said["largest_step_us"] == 60.0
    assert said["servo"] == [{"shortest_pulse_us": 1180.0, "longest_pulse_us": 2020.0}] * 3


@pytest.mark.parametrize(
    ("device", "words", "code"),
    [
        ("serial:/dev/nowhere", ("/dev/nowhere is missing", "hapticnet device find"), UNAVAILABLE),
        ("ttyUSB0", ("serial:/dev/ttyUSB0",), WRONG_SETTINGS),
    ],
)
def test_what_is_no_device_is_said_in_one_line(device, words, code):
    assert_one_line(hapticnet("device", "info", device), *words, code=code)


def test_find_says_what_to_write(monkeypatch, capsys, tmp_path):
    ports = []
    monkeypatch.setattr(serial_port, "BY_ID", tmp_path)
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    find()
    assert "is it plugged in?" in capsys.readouterr().out
    for number, vendor in enumerate((0x0403, 0x1A86)):
        ports.append(
            SimpleNamespace(device=f"/dev/ttyUSB{number}", vid=vendor, description="UART", serial_number=f"N{number}")
        )
        find()
        out = capsys.readouterr().out
        assert f"serial:/dev/ttyUSB{number}  UART, N{number}" in out
        assert ("serial:auto" in out) == (number == 0)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("step", "sim:10"), "between 0.2 and 5 N/mm"),
        (("step", "sim", "--plot", "x.xyz"), "it must be png, pdf or svg"),
        (("tune", "sim", "--max-force", "99"), "it must be at most 4.6 N"),
    ],
)
def test_what_no_finger_bears_is_refused_in_one_line(arguments, complaint, tmp_path):
    assert_one_line(hapticnet("device", *arguments, cwd=tmp_path), complaint, code=WRONG_SETTINGS)


def test_step_reports_figures_draws_only_when_asked_and_overwrites_no_figure_unasked(tmp_path):
    done = hapticnet("device", "step", "sim:0.6", "--json", cwd=tmp_path)
    report = json.loads(done.stdout)
    assert 0.0 < report["true"]["rise_s"] <= 0.2
    assert report["true"]["settling_s"] <= 0.35
    assert abs(report["sensed"]["steady_error_n"]) <= 0.05
    assert list(tmp_path.iterdir()) == []
    figure = tmp_path / "step.svg"
    figure.write_text("mine")
    done = hapticnet("device", "step", "sim:0.6", "--plot", figure)
    assert done.returncode == 2
    assert "exists" in done.stderr
    assert figure.read_text() == "mine"
    assert hapticnet("device", "step", "sim:0.6", "--plot", figure, "--overwrite").returncode == 0
    assert figure.read_text().startswith("<?xml")


def test_a_step_that_is_never_felt_is_no_success(tmp_path):
    done = hapticnet("device", "step", "sim", "--from", "0", "--to", "0.05", "--plot", tmp_path / "s.png")
    assert done.returncode == UNAVAILABLE
    assert "did not reach 90 %" in done.stderr


def test_tune_finds_the_finger_and_writes_it_into_the_profile(tmp_path):
    profile = tmp_path / "device.toml"
    done = hapticnet("device", "tune", "sim:0.3", "--out", profile, "--json")
    report = json.loads(done.stdout)
    assert report["stiffness_n_m"] == pytest.approx(300.0, rel=0.1)
    assert report["margins"]["gain"] > 2.0
    assert load_profile(profile).finger.stiffness_n_m == pytest.approx(report["stiffness_n_m"])
    done = hapticnet("device", "step", "sim:0.3", "--profile", profile, "--json", "--plot", tmp_path / "s.png")
    assert json.loads(done.stdout)["true"]["rise_s"] <= 0.2


def test_tune_overwrites_no_profile_it_does_not_go_on_from_and_leaves_no_empty_one(tmp_path):
    profile = tmp_path / "device.toml"
    profile.write_text('serial = "A9B0C1D2"\n')
    done = hapticnet("device", "tune", "sim", "--out", profile)
    assert_one_line(done, "device.toml exists", "--profile")
    assert profile.read_text() == 'serial = "A9B0C1D2"\n'
    other = tmp_path / "other.toml"
    assert_one_line(hapticnet("device", "tune", "sim", "--max-force", "0.1", "--out", other), "at least 1.2 N")
    assert not other.exists()
    assert hapticnet("device", "tune", "sim", "--profile", profile).returncode == 0
    assert load_profile(profile).serial == "A9B0C1D2"
    assert load_profile(profile).finger is not None
