import math
import time

import pytest
from dds_peers import CALM, hold, leader_behind, pose, robot_behind

import hapticnet as hn
from hapticnet_ros2 import Leader, Robot
from hapticnet_ros2.messages import Vector3


def test_a_leader_moves_the_tool_and_gets_the_force_against_its_axis(space, made):
    at = [0.3, 0.2, 0.1]
    with leader_behind(space, lambda _: (pose(*at),)) as behind:
        leader = made(Leader(space, "-zx", scale=2.0, max_force_n=3.0, **CALM))
        assert hold(leader, (0.0, 0.0), 0.2) == (0.0, 0.0)
        at[:] = 0.301, 0.2, 0.095
        assert hold(leader, (1.0, -2.0), 0.7) == pytest.approx((0.01, 0.002))
        assert behind.newest.wrench.force == Vector3(2.0, 0.0, 1.0)
        hold(leader, (3.0, 4.0), 0.1)
        force = behind.newest.wrench.force
        assert (force.x, force.z) == pytest.approx((-2.4, 1.8))  # 3 N in the same direction
        leader.close()
        time.sleep(0.05)
        assert behind.newest.wrench.force == Vector3()


def test_the_force_at_a_leader_rises_from_zero(space, made):
    with leader_behind(space, lambda _: (pose(),)) as behind:
        leader = made(Leader(space, "z", max_force_n=2.0, **CALM))
        while not leader._measured.usable(time.monotonic()):
            hold(leader, (2.0,), 0.001)
        hold(leader, (2.0,), 0.1)
        time.sleep(0.01)
        assert 0.0 < -behind.newest.wrench.force.z < 1.0


@pytest.mark.parametrize("fault", ["silent", "nan"])
def test_a_leader_that_stops_gets_no_force_and_does_not_jump(space, made, caplog, fault):
    at = [0.0]
    with leader_behind(space, lambda _: (pose(z=at[0]),)) as behind:
        leader = made(Leader(space, "z", **CALM))
        hold(leader, (1.0,), 0.2)
        at[0] = 0.01
        assert hold(leader, (1.0,), 0.5) == pytest.approx((0.01,))
        assert behind.newest.wrench.force.z == pytest.approx(-1.0)
        if fault == "nan":
            at[0] = math.nan
        else:
            behind.is_talking = False
        assert hold(leader, (1.0,), 0.6) == pytest.approx((0.01,))
        assert behind.newest.wrench.force == Vector3()
        assert len([each for each in caplog.messages if "measured_cp" in each]) == 1
        at[0], behind.is_talking = 0.5, True
        assert hold(leader, (1.0,), 0.1) == pytest.approx((0.01,))


def test_from_leader_to_robot_over_udp_and_back(space, made):
    hand_m = [0.0]
    with (
        robot_behind(f"{space}/PSM1") as robot,
        leader_behind(f"{space}/MTML", lambda _: (pose(z=-hand_m[0]),)) as device,
        hn.ThreadedSlave(Robot(f"{space}/PSM1", "-zxy", **CALM), listen="127.0.0.1:0") as slave,
    ):
        leader = made(Leader(f"{space}/MTML", "-zxy", **CALM))
        with hn.ThreadedMaster(slave.address, operator=leader, codec="deadband") as master:
            time.sleep(0.6)
            for _ in range(400):  # 4 mm in 0.4 s
                hand_m[0] += 1e-5
                time.sleep(0.001)
            time.sleep(0.6)
            assert robot.newest.pose.position.z == pytest.approx(0.1 - 0.004, abs=1e-5)
            assert master.force_n[0] == pytest.approx(1.6, rel=0.05)
            assert device.newest.wrench.force.z == pytest.approx(1.6, rel=0.05)  # out, which is along z
            assert device.newest.wrench.force.x == device.newest.wrench.force.y == 0.0
            robot.is_talking = False
            time.sleep(0.7)
            assert master.force_n[0] < 0.025  # the floor of the deadband: zero is felt as no other force
            assert device.newest.wrench.force.z < 0.025
