"""The package that ``hapticnet device new`` writes works at once."""

import os
import subprocess
import sys
import tomllib

import pytest

import hapticnet as hn
from hapticnet.device.profile import Profile
from hapticnet.device.user import UserActuator
from hapticnet.errors import SettingsError
from hapticnet.runtime import devices
from tests.cli.test_cli_errors import assert_one_line
from tests.ready import ROOT, wait_until


@pytest.fixture
def motor(run, tmp_path, monkeypatch):
    """The written package, installed as far as Python finds it."""
    done = run("device", "new", "my-motor", "--out-dir", tmp_path)
    assert (done.returncode, done.stdout.count("wrote ")) == (0, 4)
    written = tmp_path / "my-motor"
    project = tomllib.loads((written / "pyproject.toml").read_text())["project"]
    info = written / "my_motor-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = [f"{name} = {value}" for name, value in project["entry-points"]["hapticnet.devices"].items()]
    (info / "entry_points.txt").write_text("\n".join(["[hapticnet.devices]", *lines, ""]))
    monkeypatch.syspath_prepend(str(written))
    yield written
    sys.modules.pop("my_motor", None)


def test_its_tests_pass(motor):
    path = os.pathsep.join([str(motor), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(motor)],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 passed" in done.stdout


@pytest.mark.usefixtures("motor")
def test_its_name_is_a_device_with_arguments():
    with devices.real_time_device("my-motor:port=/dev/x", Profile(), 0, print) as (device, wire):
        assert isinstance(device, UserActuator)
        assert (device.description, wire) == ("my-motor on /dev/x", None)
        assert (device.capabilities.max_force_n, device.capabilities.rate_hz) == (3.0, 1000.0)
    with pytest.raises(SettingsError, match=r"did you mean 'my-motor'\?\); choose from .*, my-motor$"):
        devices.check_device("my-moto")
    with pytest.raises(SettingsError, match="'port' must be KEY=VALUE"):
        devices.check_device("my-motor:port")


@pytest.mark.usefixtures("motor")
def test_a_master_drives_it_and_tells_of_its_loss():
    with (
        hn.ThreadedSlave(Spring(), listen="127.0.0.1:0") as slave,
        hn.ThreadedMaster(slave.address, device="my-motor", codec="raw", start=0.01) as master,
    ):
        wait_until(lambda: master.node.target_n > 0.0)
        device = master.node._rendering.fingertip.device
        assert device.made.force_n > 0.0
        device._call = unplugged
        wait_until(lambda: master.ended is not None)
        failed = [event.reason for event in master.take_events() if type(event).__name__ == "Failed"]
        assert len(failed) == 1
        assert failed[0].startswith("the device failed: MyMotor.apply raised OSError: no such device")
        wait_until(lambda: master.force_n == (0.0,))


class Spring:
    def step(self, sample):
        return 200.0 * sample.position_m[0]


def unplugged(*_):
    raise OSError("no such device")


@pytest.mark.parametrize("name", ["sim", "My-Motor", "1motor", "../up", "my motor", "", "class", "json", "numpy"])
def test_other_names_are_refused(run, tmp_path, name):
    done = run("device", "new", name, "--out-dir", tmp_path)
    assert done.returncode == 2
    assert_one_line(done)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(run, tmp_path):
    (tmp_path / "my-motor").mkdir()
    done = run("device", "new", "my-motor", "--out-dir", tmp_path)
    assert done.returncode == 3
    assert "File exists; nothing is overwritten" in done.stderr
    assert list((tmp_path / "my-motor").iterdir()) == []
