"""The programs of examples/ do what they say."""

import asyncio
import os
import re
import socket
import struct
import subprocess
import sys
import time
import types
from pathlib import Path
from unittest.mock import MagicMock

import pytest

import hapticnet as hn
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.device.user import UserDevice
from hapticnet.node.fingertip import Fingertip
from hapticnet.operator.base import UserOperator
from hapticnet.runtime.scene_port import find_live_source
from hapticnet.samples import PositionSample
from hapticnet.user_code import find_user_class, load_user_code
from tests.ready import wait_until

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = sorted({*EXAMPLES.glob("*.py"), *EXAMPLES.glob("*.c")} - {*EXAMPLES.glob("smallest_*.py")})


@pytest.fixture(autouse=True)
def leave_no_traces(monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path[:])


def load(source):
    return load_user_code(source, "example", EXAMPLES)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_an_example_is_short_and_named_in_the_page(file):
    assert len(file.read_text().splitlines()) <= (60 if file.suffix == ".c" else 40)
    assert f"examples/{file.name}" in (EXAMPLES.parent / "docs" / "use" / "embedding.md").read_text()


def test_the_explorer_finds_the_ball_and_presses_with_the_force_it_wants():
    ball, hand = load("own_scene.py:Ball")(), load("own_hand.py:Explorer")(force_n=0.8)
    link = hn.virtual_link(scene=ball, operator=hand, codec="deadband")
    link.run(seconds=hand.duration_us / 1e6)
    assert hand.felt_n == pytest.approx(0.8, abs=0.1)
    assert link.report().scene == "ball"


def test_the_force_loop_drives_the_platform():
    device = UserDevice(find_user_class("own_device.py:Platform:port=COM3", "device", EXAMPLES).make())
    assert device.description == "platform on COM3"
    fingertip = Fingertip(device, ForceControlSettings())
    for now_us in range(1000, 3_000_000, 1000):
        fingertip.press(1.5, now_us)
    assert fingertip.sensed_n == pytest.approx(1.5, abs=0.1)


def test_the_stick_of_a_gamepad_sets_the_speed_of_the_tool(tmp_path):
    pipe = tmp_path / "js0"
    os.mkfifo(pipe)
    gamepad = load("gamepad.py:Gamepad")(device=str(pipe))
    hand = UserOperator(gamepad)
    with open(pipe, "wb", buffering=0) as stick:

        def move(value):
            stick.write(struct.pack("=IhBB", 0, 123, 0x01, 0) + struct.pack("=IhBB", 0, value, 0x02, 1))

        def at(from_ms, to_ms):
            return [hand.sample(1000 * ms).position_m[0] for ms in range(from_ms, to_ms)]

        assert at(0, 10)[-1] == 0.0
        move(-32767)
        assert at(10, 510)[-1] == pytest.approx(0.03)
        move(0)
        assert at(510, 600)[-1] == pytest.approx(0.03)
        move(32767)
        assert at(600, 2000)[-1] == 0.0
        gamepad.close()


def test_slave_and_master_in_one_asyncio_program(capsys):
    asyncio.run(load("in_asyncio.py:main")())
    said = capsys.readouterr().out
    assert said.count("Connected(") == 2, "the codec was changed"
    assert "Ended(reason='done'" in said
    applied, true = map(float, re.search(r"([\d.]+) N in front of the wall's ([\d.]+) N", said).groups())
    assert applied == pytest.approx(2.0, abs=0.3)
    assert true == pytest.approx(2.0, abs=0.3)


def test_a_master_in_a_program_with_its_own_loop(capsys):
    with hn.ThreadedSlave("paper:1", listen="127.0.0.1:0") as slave:
        assert load("in_a_loop.py:main")(slave.address, 1.0) > 1.0
    assert "Connected(" in capsys.readouterr().out


def test_a_ros_node_touches_a_ball(monkeypatch):
    ros = MagicMock()

    class Node:
        """What the example uses of rclpy.node.Node."""

        def __init__(self, name):
            self.get_name = lambda: name

        def __getattr__(self, name):
            return getattr(ros, name)

    messages = types.SimpleNamespace(PointStamped=MagicMock, WrenchStamped=MagicMock)
    node_module = types.SimpleNamespace(Node=Node)
    modules = {"rclpy": ros, "rclpy.node": node_module, "geometry_msgs": ros, "geometry_msgs.msg": messages}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    with hn.ThreadedSlave(load("own_scene.py:Ball")(), listen="127.0.0.1:0") as slave:
        ros.declare_parameter.return_value.value = slave.address
        node = load("ros_node.py:Touch")()
        ros.declare_parameter.assert_called_once_with("slave", "127.0.0.1:47800")
        ros.create_publisher.assert_called_once_with(MagicMock, "touch", 10)
        ros.create_subscription.assert_called_once_with(MagicMock, "tool", node.on_tool, 10)
        ros.create_timer.assert_called_once_with(1.0 / 500.0, node.on_timer)
        tool = MagicMock()
        tool.point.x, tool.point.y, tool.point.z = 0.0, 0.01, 0.0
        node.on_tool(tool)

        def published():
            node.on_timer()
            return ros.create_publisher().publish.call_args.args[0]

        wait_until(lambda: published().wrench.force.y > 2.85)
        force = published().wrench.force
        assert (force.x, force.y, force.z) == pytest.approx((0.0, 3.0, 0.0), abs=0.2)
        assert published().header.stamp is ros.get_clock().now().to_msg()
        assert ros.get_logger().info.call_args_list[0].args[0].startswith("Connected(")
        node.master.close()


def test_a_program_moves_the_tool_by_udp(capsys):
    with hn.ThreadedSlave("paper:1", listen="127.0.0.1:0") as slave:
        command = ["master", "--connect", slave.address, "--operator", "udp:0", "--device", "none", "--no-real-time"]
        master = subprocess.Popen(
            [sys.executable, "-m", "hapticnet", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        try:
            port = None
            for line in master.stderr:
                if found := re.search(r"positions are read from 127\.0\.0\.1:(\d+)", line):
                    port = int(found[1])
                if "connected to" in line:
                    break
            assert load("udp_client.py:main")(port, 2.0) > 1.0
        finally:
            master.terminate()
            out, err = master.communicate(timeout=20)
    assert master.returncode == 0, err
    assert re.search(r"positions come from 127\.0\.0\.1:\d+, as JSON object", err)
    assert " mm " in capsys.readouterr().out
    assert re.search(r"answers +\d{2}", out)


@pytest.fixture(scope="module", params=["udp_scene.py", "udp_scene.c"])
def program(request, tmp_path_factory):
    """The command of a scene in another program, without its port."""
    source = EXAMPLES / request.param
    if source.suffix == ".py":
        return [sys.executable, str(source)]
    binary = tmp_path_factory.mktemp("c") / "udp_scene"
    strict = ["-std=c11", "-D_DEFAULT_SOURCE", "-Wall", "-Wextra", "-Werror", "-O2"]
    subprocess.run(["gcc", *strict, "-o", str(binary), str(source)], check=True)
    return [str(binary)]


def test_a_scene_in_another_program_is_asked_by_udp_and_its_force_ends_with_it(program):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    scene = find_live_source(f"udp:{port}").make()

    def force_n(depth_m):
        time.sleep(0.001)
        force_n.t_us += 1000
        return scene.step(PositionSample(force_n.t_us, (depth_m,))).force_n[0]

    force_n.t_us = 0
    wall = subprocess.Popen([*program, str(port)])
    try:
        wait_until(lambda: force_n(0.015) == pytest.approx(2.0))
        wait_until(lambda: force_n(0.005) == 0.0)
        time.sleep(0.1)  # with few positions each answer waits for the next one, which is not late
        force_n(0.015)
        time.sleep(0.1)
        assert force_n(0.015) > 0.0
    finally:
        wall.kill()
        wall.wait()
    wait_until(lambda: force_n(0.015) == 0.0)
    assert scene.report()["malformed"] == 0
    assert 0 < scene.report()["answers"] < scene.report()["asked"]


def test_two_masters_hold_one_box_and_each_feels_the_other():
    left, right = load("shared_box.py:Side")(), load("shared_box.py:Side")()
    left.welcome("left")
    right.welcome("right")
    with pytest.raises(ValueError, match="no side 'top'"):
        load("shared_box.py:Side")().welcome("top")
    for t_us in range(0, 5_000_000, 1000):
        deeper = 0.055 + 0.002 * (t_us > 2_000_000)
        felt_n = [side.step(PositionSample(t_us, (place,))) for side, place in ((left, deeper), (right, 0.055))]
        if t_us == 2_000_000:
            assert felt_n == pytest.approx([2.0, 2.0], rel=0.02)
    assert felt_n == pytest.approx([2.4, 2.4], rel=0.02)  # the left one has pushed the box into the right hand
