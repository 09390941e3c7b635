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
        received, x_m, z_m, w = process.communicate()[0].split()
    assert int(received) > 500
    assert (float(x_m), float(z_m), float(w)) == (0.0, 0.095, 1.0)
