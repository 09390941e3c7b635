import math
import os
import shutil
import signal
import statistics
import subprocess
import time
from pathlib import Path

import pytest
from dds_peers import CALM, DOMAIN, settle, step

from hapticnet_ros2 import Robot


@pytest.fixture(scope="module")
def fast_robot(tmp_path_factory):
    source, program = Path(__file__).with_name("fast_robot.cpp"), tmp_path_factory.mktemp("fast") / "fast_robot"
    if not Path("/usr/include/fastdds").exists() or not shutil.which("g++"):
        if os.environ.get("CI"):
            pytest.fail("needs g++ and libfastrtps-dev, which make system-packages installs; CI must have them")
        pytest.skip("needs g++ and libfastrtps-dev: make system-packages")
    subprocess.run(["g++", "-std=c++17", source, "-o", program, "-lfastrtps", "-lfastcdr"], check=True)
    return program


@pytest.mark.parametrize("quality", ["reliable", "best"])
def test_another_implementation_of_dds_reads_and_writes_the_same(fast_robot, space, made, quality):
    command = [fast_robot, str(DOMAIN), space, quality]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        robot = made(Robot(space, "-z", **CALM))
        until_s = time.monotonic() + 5.0
        while not robot._force.newest.values and time.monotonic() < until_s:  # until they have found each other
            settle(robot, 0.0)
        assert settle(robot, 0.005, seconds=1.0) == pytest.approx((2.0,))
        process.send_signal(signal.SIGSTOP)  # a subscriber that hangs holds nobody up
        took_s = []
        for _ in range(600):
            began_s = time.monotonic()
            force_n = step(robot, 0.005)
            took_s.append(time.monotonic() - began_s)
            time.sleep(0.001)
        assert force_n == (0.0,)
        assert statistics.quantiles(took_s, n=20)[-1] < 0.01
        process.send_signal(signal.SIGCONT)
        received, *told = map(float, process.communicate()[0].split())
    assert received > 200
    assert told == [0.0, 0.095, 0.0, 1.0, 0.04]


def test_it_reads_and_writes_orientation_wrench_and_jaw_too(fast_robot, space, made):
    with subprocess.Popen([fast_robot, str(DOMAIN), space, "reliable"], stdin=-1, stdout=-1, text=True) as process:
        robot = made(Robot(space, "xyz", parts="force+torque+grip", **CALM))
        until_s = time.monotonic() + 5.0
        while not (robot._zero_m and robot._opening) and time.monotonic() < until_s:
            settle(robot, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.04)
        felt = settle(robot, 0.0, 0.0, -0.005, 0.0, 0.0, 0.2, 0.02, seconds=1.0)
        assert felt == pytest.approx((0.0, 0.0, -2.0, 0.0, 0.0, 0.1, -2.0), abs=1e-6)
        _, *told = map(float, process.communicate()[0].split())
    assert told == pytest.approx([0.0, 0.095, math.sin(0.1), math.cos(0.1), 0.02], abs=1e-6)
