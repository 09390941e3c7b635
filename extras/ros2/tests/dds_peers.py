"""Robots and hands behind DDS, and what tests do with them."""

import threading
import time
from functools import cache

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

import hapticnet as hn
from hapticnet_ros2.messages import (
    Header,
    JointState,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Time,
    Vector3,
    Wrench,
    WrenchStamped,
)
from hapticnet_ros2.topics import BEST_EFFORT, RELIABLE, TOPIC, participant

DOMAIN = 88
HERE = {"domain": DOMAIN, "interface": "lo"}
CALM = HERE | {"fresh_ms": 200.0}  # processes of a busy machine stand still for longer than 20 ms
POSE, WRENCH = (f"geometry_msgs::msg::dds_::{each}Stamped_" for each in ("Pose", "Wrench"))


def pose(x=0.0, y=0.0, z=0.0, stamp=None, turn=(0.0, 0.0, 0.0, 1.0)):
    return PoseStamped(Header(stamp or now()), Pose(Point(x, y, z), Quaternion(*turn)))


def wrench(x=0.0, y=0.0, z=0.0, stamp=None, torque=()):
    return WrenchStamped(Header(stamp or now()), Wrench(Vector3(x, y, z), Vector3(*torque)))


def joint(position, effort=None):
    return JointState(Header(now()), ["jaw"], [position], [], [] if effort is None else [effort])


def now():
    return Time(*divmod(time.time_ns(), 1_000_000_000))


@cache
def there():
    participant(**HERE)  # which chooses the interface of this process
    return DomainParticipant(DOMAIN)


def writer(topic, kind, qos=BEST_EFFORT):
    return DataWriter(there(), Topic(there(), f"rt{topic}", kind, qos=TOPIC), qos=qos)


def reader(topic, kind, qos=BEST_EFFORT):
    return DataReader(there(), Topic(there(), f"rt{topic}", kind, qos=TOPIC), qos=qos)


class Behind:
    """A robot behind DDS that moves at once, in front of a spring, or a hand: whatever `answer` makes of messages."""

    def __init__(self, answer, outputs, heard=None, period_s=0.001):
        self.outputs, self.heard, self.answer, self.newest = outputs, heard, answer, None
        self.is_talking, self._ends, self._period_s = True, False, period_s
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._ends:
            if self.heard is not None:
                found = self.heard.take(1)
                self.newest = found[0] if found and found[0].sample_info.valid_data else self.newest
            if self.is_talking:
                for output, message in zip(self.outputs, self.answer(self.newest), strict=True):
                    if message is not None:
                        output.write(message)
            time.sleep(self._period_s)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ends = True
        self._thread.join()


def robot_behind(space, answer=None, kind=PoseStamped, qos=BEST_EFFORT):
    """A robot that is at 0.1 m on each axis first, and feels 400 N/m against what moves it away."""

    def spring(newest):
        at = newest.pose.position if newest else Point(0.1, 0.1, 0.1)
        felt_n = (-400.0 * (each - 0.1) for each in (at.x, at.y, at.z))
        return pose(at.x, at.y, at.z), wrench(*felt_n)

    outputs = [writer(f"{space}/measured_cp", kind, qos), writer(f"{space}/measured_cf", WrenchStamped, qos)]
    return Behind(answer or spring, outputs, reader(f"{space}/servo_cp", kind, qos))


def step(robot, *position_m):
    return robot.step(hn.PositionSample(0, position_m))


def settle(robot, *position_m, seconds=0.2):
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        force_n = step(robot, *position_m)
        time.sleep(0.001)
    return force_n


def leader_behind(space, answer):
    """A device whose `newest` is the force that it was told."""
    outputs = [writer(f"{space}/measured_cp", PoseStamped)]
    return Behind(answer, outputs, reader(f"{space}/servo_cf", WrenchStamped, RELIABLE))


def hold(leader, force_n, seconds):
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        leader.feel(0, force_n)
        sample = leader.sample(0)
        time.sleep(0.001)
    return sample.position_m
