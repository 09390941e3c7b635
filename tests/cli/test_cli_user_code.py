"""Classes of users on the command line: scenes, operators and devices."""

import asyncio
import json
import re

import pytest

from hapticnet.cli.operators import make_operator
from hapticnet.device.profile import Profile
from hapticnet.errors import RunError, SettingsError
from hapticnet.operator.base import UserOperator
from hapticnet.operator.remote import RemoteOperator
from hapticnet.runtime import devices
from tests.integration.conftest import serve, start  # noqa: F401 - fixtures
from tests.ready import hapticnet

RIG = """
import sys

class Sphere:
    axes = 3
    def step(self, sample):
        return [100.0 * x for x in sample.position_m]
    def close(self):
        print("sphere closed", file=sys.stderr)

class Fragile:
    def step(self, sample):
        if sample.position_m[0] > 0.005:
            raise ValueError("it broke")
        return 0.0

class Orbit:
    axes = 3
    duration_us = 300_000
    def __init__(self, radius=0.01):
        self.radius, self.felt = radius, ()
    def sample(self, t_us):
        return self.radius, 0.0, -self.radius
    def feel(self, t_us, force_n):
        self.felt = max(self.felt, force_n)
    def close(self):
        print(" ".join(["felt", *(str(round(f, 2)) for f in self.felt)]), file=sys.stderr)  # at once: others write, too

class Push(Orbit):
    axes = 1
    def sample(self, t_us):
        return 1e-7 * t_us

class Motor:
    def exchange(self, displacement_m, now_us):
        return max(0.0, 1000.0 * (displacement_m - 0.002))
    def close(self):
        print("motor off", file=sys.stderr)
"""


@pytest.fixture(autouse=True)
def rig(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.py").write_text(RIG)


def make(spec, said=None):
    tell = (said if said is not None else []).append
    return make_operator(spec, insertions=1, seed=0, say=tell, warn=tell)


def test_a_class_of_the_user_is_an_operator():
    hand = make("rig.py:Orbit:radius=0.03")
    assert isinstance(hand.operator, UserOperator)
    assert hand.operator.sample(0).position_m == (0.03, 0.0, -0.03)
    assert (str(hand.file), hand.report(), len(hand.watchers)) == ("rig.py", None, 1)
    assert [make(spec).operator.axes for spec in ("palpation", "palpation:axes=2")] == [3, 2]


def test_a_udp_operator_listens_on_loopback_unless_a_host_is_named():
    said = []
    hands = [make(spec, said) for spec in ("udp:0", "udp:127.0.0.1:0,axes=3", "udp:0.0.0.0:0")]
    for each in hands:
        asyncio.run(each.watchers[0].stop())
    hand = hands[0]
    assert isinstance(hand.operator, RemoteOperator)
    assert re.fullmatch(r"positions are read from 127\.0\.0\.1:\d+", said[0])
    assert hands[1].operator.axes == 3
    assert said[1].endswith(", 3 axes")
    assert said[3].startswith("anyone who reaches 0.0.0.0:")
    assert len(said) == 4
    assert hand.report() == {"positions": 0, "malformed": 0, "unknown_peers": 0, "silences": 0, "answers": 0}


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (
            "scriptd",
            r"unknown operator 'scriptd' \(did you mean 'scripted'\?\); there are: scripted, palpation\[:axes=2\]",
        ),
        ("palpation:axes=4", "expected palpation"),
        ("udp:fast", "port 'fast' of address"),
        ("udp:1234,axes=4", "axes is '4'; it must be 1, 2 or 3"),
        ("udp:1234,axis=2", r"has no 'axis' \(did you mean 'axes'\?\); there are: axes"),
        ("rig.py:Motor", r"operator rig.py:Motor: has no method sample\(t_us\)"),
        (
            "rig.py:Orbit:size=1",
            "operator rig.py:Orbit: making it raised TypeError: .*unexpected keyword argument 'size'",
        ),
        ("rig.py", "name the class in the file too"),
    ],
)
def test_operators_that_cannot_be_used_are_refused_in_one_line(spec, message):
    with pytest.raises(SettingsError, match=message) as refused:
        make(spec)
    assert "\n" not in str(refused.value)


def test_a_class_of_the_user_is_a_device_that_is_retracted_and_closed_at_the_end(capfd):
    with devices.real_time_device("rig.py:Motor", Profile(), 0, print) as (device, wire):
        assert wire is None
        assert device.exchange(0.003, 1000).force_n == pytest.approx(1.0)
    assert capfd.readouterr().err == "motor off\n"
    with pytest.raises(SettingsError, match=r"device rig.py:Orbit: has neither exchange"):
        devices.real_time_device("rig.py:Orbit", Profile(), 0, print).__enter__()
    with pytest.raises(SettingsError, match=r"unknown device 'dev/tty'; choose from sim.*FILE\.py:CLASS"):
        devices.check_device("dev/tty")


def test_own_scene_own_hand_and_own_device_play_together_along_three_axes(serve, tmp_path):  # noqa: F811
    slave, address = serve("--scene", f"{tmp_path}/rig.py:Sphere", "--json")
    played = hapticnet(
        "master", "--connect", address, "--operator", "rig:Orbit:radius=0.02", "--device", "rig.py:Motor",
        "--device-takes", "z", "--no-real-time", "--json", "--codec", "raw",
    )  # fmt: skip
    assert played.returncode == 0, played.stderr
    assert "felt 2.0 0.0 -2.0" in played.stderr
    assert "motor off" in played.stderr
    report = json.loads(played.stdout)
    assert (report["scene"], report["device"]["description"]) == ("Sphere", "Motor (own device)")
    assert slave.end() == 0
    assert "sphere closed" in slave.said()


def test_a_scene_that_breaks_ends_the_session_with_one_line_on_both_sides_and_the_slave_goes_on(serve, tmp_path):  # noqa: F811
    failure = "the scene failed: Fragile.step raised ValueError: it broke (rig.py, line 14)"
    slave, address = serve("--scene", f"{tmp_path}/rig.py:Fragile", "--json")
    for _ in range(2):
        played = hapticnet(
            "master", "--connect", address, "--operator", "rig.py:Push", "--device", "none", "--no-real-time"
        )
        assert played.returncode != 0
        assert played.stderr.splitlines()[-1].endswith(f"hapticnet: the slave closed: {failure}")
        assert "Traceback" not in played.stderr
    assert slave.end() == RunError.exit_code
    warnings = [line for line in slave.said().splitlines() if " warning slave: 'master' left: " in line]
    assert len(warnings) == 2
    assert all(failure in line for line in warnings)
    assert "Traceback" not in slave.said()
    report = slave.report()
    assert len(report["sessions"]) == 2
    assert report["faults"] == [failure]
    assert slave.said().splitlines()[-1].endswith(f"hapticnet: {failure}")


def test_a_scene_of_ones_own_is_tried_without_a_network():
    with open("path.csv", "w") as file:
        file.write("t_us,position_m\n0,0.001\n1000,0.004\n2000,0.006\n3000,0.007\n")
    tried = hapticnet("compare", "path.csv", "--scene", "rig.py:Fragile")
    assert tried.stderr.strip().endswith("hapticnet: Fragile.step raised ValueError: it broke (rig.py, line 14)")
    assert hapticnet("scene", "show", "rig.py:Sphere", "--json").stdout.startswith(
        '{\n  "name": "Sphere",\n  "axes": 3'
    )
