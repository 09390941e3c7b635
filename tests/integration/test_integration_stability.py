"""A hand that yields, in real time between two processes: it does what it does in virtual time."""

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.operator.trace import load_trace
from hapticnet.operator.yielding import HANDS, YieldingOperator
from hapticnet.recordings.text import read_csv
from tests.integration.test_integration_two_hosts import SLAVE_IP, hosts  # noqa: F401

WALL = """\
name = "wall"
[[tissue]]
name = "wall"
rest_position_m = 0.0
stiffness_n_per_m = 300.0
breach_force_n = 1e6
"""
DELAY = "delay=25ms"
SECONDS = 6


@pytest.fixture
def pressing(tmp_path):
    """Return the scene of a wall, and an arm that means to press it for six seconds."""
    scene, motion = tmp_path / "wall.toml", tmp_path / "press.csv"
    scene.write_text(WALL)
    times = np.arange(0.0, SECONDS, 0.01)
    rows = [f"{t:.3f},{-0.005 + 0.03 * min(t, 1.0):.6f}" for t in times]
    motion.write_text("t_s,position_m\n" + "\n".join(rows) + "\n")
    return str(scene), motion


def swing_m(table):
    return np.ptp(table["position_m"][-1500:])


def virtual(scene, motion, coupling):
    operator = YieldingOperator(load_trace(motion)[0], HANDS["arm"])
    link = hn.virtual_link(scene=scene, operator=operator, coupling=coupling, forward=DELAY, feedback=DELAY)
    link.run(seconds=SECONDS + 0.5)
    return swing_m(link.master_samples())


@pytest.mark.parametrize("coupling", ["direct", "energy-bounded"])
@pytest.mark.parametrize("between", ["processes", "hosts"])
def test_a_hand_swings_in_real_time_as_in_virtual_time(between, coupling, pressing, start, tmp_path, request):
    scene, motion = pressing
    inside, address, insecure = ((), ()), "127.0.0.1:0", ()
    if between == "hosts":
        inside = [("ip", "netns", "exec", host) for host in request.getfixturevalue("hosts")]
        address, insecure = f"{SLAVE_IP}:47800", ("--insecure",)
    slave = start("slave", "--listen", address, "--scene", scene, "--channel-out", DELAY, *insecure, prefix=inside[0])
    address = slave.wait_for(r"listening on ([\d.]+:\d+)").group(1)
    record = tmp_path / "master.csv"
    master = start(
        "master", "--connect", address, "--operator", f"hand:arm,motion=trace:{motion}",
        "--channel-out", DELAY, "--coupling", coupling, "--record", str(record), *insecure, prefix=inside[1],
    )  # fmt: skip
    assert master.process.wait(60) == 0, master.said()
    assert slave.end() == 0
    assert ("warning master: this device pushes the hand" in master.said()) == (coupling == "direct")
    expected_m, found_m = virtual(scene, motion, coupling), swing_m(read_csv(record))
    if coupling == "direct":
        assert expected_m > 0.05
        assert found_m == pytest.approx(expected_m, rel=0.25)  # loose: this machine may be late by milliseconds
    else:
        assert max(expected_m, found_m) < 2e-3
        assert "the force is held back" in master.said()
