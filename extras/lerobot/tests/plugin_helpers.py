"""Robots, hands and clocks of these tests."""

import time

import hapticnet as hn
from lerobot_robot_hapticnet import (
    Follower,
    HapticnetRobot,
    HapticnetRobotConfig,
    HapticnetSimulated,
    HapticnetSimulatedConfig,
    HapticnetTeleoperator,
    HapticnetTeleoperatorConfig,
)

AT_REST = 2.0  # N at a goal 20 mm: servo 300 N/m and wall 600 N/m in series, 10 mm deep


class Clock:
    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


class Still:
    """A hand that is held at a place."""

    def __init__(self, to=0.0):
        self.to, self.force_n, self.forces = to, 0.0, []

    def feel(self, _t_us, force_n):
        (self.force_n,) = force_n
        self.forces.append(self.force_n)

    def sample(self, t_us):
        return self.to * min(t_us / 200_000, 1.0)


HANDS = []


def made_hand(to=0.0):
    HANDS.append(Still(to))
    return HANDS[-1]


def simulated(tmp_path, clock=None, **config):
    robot = HapticnetSimulated(HapticnetSimulatedConfig(id="it", calibration_dir=tmp_path, **config))
    if clock is not None:
        robot.clock = clock
    return robot


def follower(tmp_path, clock, **options):
    own = {key: options.pop(key) for key in ("reports_force", "lag_s") if key in options}
    return Follower(simulated(tmp_path, clock, **own), units_per_m=1000.0, clock=clock, **options)


def play(scene, clock, position_m, seconds, hz=1000):
    """Hold a position, and return the force at the end."""
    force_n = None
    for tick in range(round(seconds * hz)):
        clock.now_s += 1.0 / hz
        if tick % 16 == 0:
            scene.cycle()
        force_n = scene.step(hn.PositionSample(round(1e6 * clock.now_s), position_m))
    return force_n


def remote(tmp_path, address, **more):
    return HapticnetRobot(
        HapticnetRobotConfig(id="far", calibration_dir=tmp_path, address=address, units_per_m=1000.0, **more)
    )


def teleoperator(tmp_path, address="", **more):
    more = {"hand": f"{__name__}:made_hand:to=0.02", "units_per_m": 1000.0, **more}
    return HapticnetTeleoperator(
        HapticnetTeleoperatorConfig(id="hand", calibration_dir=tmp_path, address=address, **more)
    )


def until(true, seconds=10.0):
    end_s = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end_s, "it took too long"
        time.sleep(0.01)


class Broken(HapticnetSimulated):
    how = ""

    def get_observation(self):
        if self.how == "unplugged":
            raise OSError(5, "Input/output error")
        return {**super().get_observation(), **({self.how: float("nan")} if self.how else {})}
