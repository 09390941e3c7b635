"""A Haply Inverse3, its service and its hand, from end to end in real time."""

import signal
import time

import pytest

from tests.integration.conftest import serve, start  # noqa: F401 - fixtures
from tests.ready import wait_until
from tests.runtime.inverse3 import HAND, StandIn

WALL = """
name = "wall"
[[tissue]]
name = "wall"
rest_position_m = 0.01
stiffness_n_per_m = 300.0
breach_force_n = 500.0
"""


@pytest.fixture
def held(serve, start, tmp_path):  # noqa: F811
    """Return what starts a slave with a wall, and a master whose hand holds a stand-in."""
    (tmp_path / "wall.toml").write_text(WALL)

    def begin(device, *options):
        _, address = serve("--scene", str(tmp_path / "wall.toml"))
        operator = f"haply:{device.address},max-force=4"
        return start("master", "--connect", address, "--device", "none", "--operator", operator, "--json", *options)

    return begin


def pressed_n(scale):
    """Return the force at which the hand's spring and the wall balance: 135 (30 mm − x) = 300 (scale x − 10 mm)."""
    at_m = (300.0 * 0.01 + HAND.stiffness_n_per_m * 0.03) / (300.0 * scale + HAND.stiffness_n_per_m)
    return HAND.stiffness_n_per_m * (0.03 - at_m)


def wait_for_force(device, expected_n):
    wait_until(lambda: device.force == pytest.approx(expected_n, rel=0.07))
    time.sleep(0.3)
    wait_until(lambda: device.force == pytest.approx(expected_n, rel=0.07))
    assert 0.03 - device.down_m == pytest.approx(expected_n / HAND.stiffness_n_per_m, abs=2e-3)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_the_hand_rests_where_its_spring_and_the_scaled_wall_balance(held, scale):
    with StandIn() as device:
        master = held(device, "--scale", str(scale))
        wait_for_force(device, pressed_n(scale))
        assert master.end(signal.SIGTERM) == 0
        assert device.forces[1][1] == device.force == 0.0
    assert master.report()["operator"]["states"] > 100
    assert "info master: Inverse3 049D holds the tool, at most 4 N" in master.said()
    assert master.said().count("try --coupling energy-bounded") == 1


def test_every_fault_takes_the_force_away_with_one_line_and_it_returns_slowly(held):
    lines = {
        "garbage": "sent what is not JSON; the force is zero",
        "nan": "is not three numbers within 1 m; the force is zero",
        "silent": "is silent for 100 ms; the force is zero",
        "other": "has no Inverse3 049D; the force is zero",
        "close": "no Haply service at .*; the force is zero",
    }
    with StandIn(deepest_m=0.5) as device:
        master = held(device)
        for fault, line in lines.items():
            wait_until(lambda: device.force > 0.5)
            first, device.fault = len(device.forces), fault
            master.wait_for(line)
            if fault in ("garbage", "nan"):  # with the others nothing is commanded any more: the device is idle
                wait_until(lambda: device.force == 0.0)
            device.fault = ""
            wait_until(lambda: len(device.forces) > first + 5 and device.force > 0.0)  # noqa: B023
            zero_s = max(at for at, force in device.forces[first:] if force < 0.05)
            assert all(force <= 8.0 * (at - zero_s) + 0.3 for at, force in device.forces if at > zero_s)
        assert device.connections == 3  # "other" and "close" connect again
        assert master.end(signal.SIGTERM) == 0
        assert device.force == 0.0
        assert max(force for _, force in device.forces) <= 4.0
    assert master.said().count("the force is zero") == len(lines)


def test_the_button_lets_go_of_the_tool_without_a_jump_and_a_slow_service_is_a_line(held):
    with StandIn() as device:
        master = held(device)
        wait_for_force(device, pressed_n(1.0))
        device.button = True
        wait_until(lambda: device.force == 0.0 and device.down_m > 0.0299)  # nothing holds the hand up
        device.button = False
        # The tool stayed where the wall pressed; now it goes back with the hand, until its spring balances the rest.
        share = HAND.stiffness_n_per_m / (300.0 + HAND.stiffness_n_per_m)
        wait_for_force(device, share * pressed_n(1.0))
        device.fault = "slow"
        master.wait_for("takes more than 2 ms to answer")
        assert master.end(signal.SIGTERM) == 0
        assert device.force == 0.0


def test_another_device_and_a_missing_service_are_one_line_each(held):
    with StandIn() as device:
        device.fault = "minverse"
        master = held(device)
        master.wait_for("has no Inverse3; the force is zero")
        device.fault = ""
        master.wait_for("Inverse3 049D holds the tool")
    master.wait_for(f"warning master: no Haply service at {device.address}; the force is zero")
    assert master.end(signal.SIGTERM) == 0
